"""From a ViGIR step plan to the Motion System's footsteps, or to the reason why not.

Everything is checked before anything is sent: `convert` returns the whole plan or raises. Displacements are those of
a sole seen from the other foot's sole, turned by that foot's heading: x forward, y left, z up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import geometry_msgs.msg
from vigir_footstep_planning_msgs import msg as vigir
from vigir_footstep_planning_msgs.msg import ErrorStatus, FootstepExecutionStatus, StepPlan

from valor.common.errors import RefusalError
from valor.common.poses import Pose
from valor.robot.footsteps import FEET, LEFT, RIGHT, UNIT, Step, StepRule

PlannedStep = Step[Pose]
TERMS = ("swing_height", "step_duration", "sway_duration")
"""What ViGIR's planner calls the numbers of a step."""

_F, _E = FootstepExecutionStatus, ErrorStatus


class PlanError(RefusalError):
    """A plan that the robot does not get.

    Attributes:
        status: flags of FootstepExecutionStatus.
        error: flags of ErrorStatus.
    """

    def __init__(self, status: int, error: int, text: str) -> None:
        super().__init__("plan", text)
        self.status = status
        self.error = error


def _invalid(text: str) -> PlanError:
    return PlanError(_F.ERR_INVALID_PLAN, _E.ERR_INVALID_STEP, text)


def _inconsistent(text: str) -> PlanError:
    return PlanError(_F.ERR_INCONSISTENT_STEP_PLAN, _E.ERR_INCONSISTENT_STEP_PLAN, text)


def _indices(text: str) -> PlanError:
    return PlanError(_F.ERR_INVALID_INCONSISTENT_INDICES, _E.ERR_INCONSISTENT_STEP_PLAN, text)


@dataclass(frozen=True)
class RunningPlan:
    """The plan that the Motion Manager executes."""

    steps: Sequence[PlannedStep]
    first_changeable: int  # step index, at most one behind the last step's; -1: nothing can be changed any more

    def step(self, index: int) -> PlannedStep | None:
        """The step of an index."""
        at = index - self.steps[0].index
        return self.steps[at] if 0 <= at < len(self.steps) else None

    def updated(self, steps: Sequence[PlannedStep]) -> list[PlannedStep]:
        """The plan after an accepted update: what comes before it, then the update."""
        return [step for step in self.steps if step.index < steps[0].index] + list(steps)


def check_size(plan: StepPlan, rule: StepRule) -> None:
    """Refuse a plan by its length alone, before any work on its steps.

    Raises:
        PlanError: no steps, or too many.
    """
    if not plan.steps:
        raise PlanError(
            _F.ERR_EMPTY_PLAN, _E.ERR_INCONSISTENT_REQUEST, "the plan has no steps, and no plan runs that it could stop"
        )
    if len(plan.steps) > rule.limits.max_steps:
        raise PlanError(
            _F.ERR_INVALID_PLAN,
            _E.ERR_INVALID_PARAMETERS,
            f"the plan has {len(plan.steps)} steps; the robot takes at most {rule.limits.max_steps}",
        )


def frame(plan: StepPlan) -> str:
    """The frame that a plan is in.

    Raises:
        PlanError: none is named, or a step or the start is in another.
    """
    name: str = plan.header.frame_id
    if not name:
        raise _inconsistent("the plan names no frame; expected header.frame_id")
    for what in (plan.start, plan.start.left, plan.start.right):
        if what.header.frame_id not in ("", name):
            raise _inconsistent(f"the start feet are in frame {what.header.frame_id!r}, the plan in {name!r}")
    for step in plan.steps:
        for header in (step.header, step.foot.header):
            if header.frame_id not in ("", name):
                raise _inconsistent(f"{_name(step)}: in frame {header.frame_id!r}, the plan in {name!r}")
    return name


def convert(
    plan: StepPlan, rule: StepRule, running: RunningPlan | None = None, to_odom: Pose | None = None
) -> list[PlannedStep]:
    """The steps of a plan that shall be taken.

    Args:
        plan: from ROS; all poses in one frame, at the soles.
        rule: of the robot.
        running: what the plan is an update of. None: nothing runs, and the plan begins with step 0.
        to_odom: the plan's frame in odom; None: it is odom.

    Returns:
        The whole plan; of an update, the steps from the first that changes, moved so that this step stays where the
        running plan has it.

    Raises:
        PlanError: the plan is refused; names the step and what was expected.
    """
    check_size(plan, rule)
    frame(plan)
    first = plan.steps[0].step_index
    if running is None and first != 0:
        raise PlanError(
            _F.ERR_NON_ZERO_INITIAL_STEP,
            _E.ERR_INCONSISTENT_STEP_PLAN,
            f"the plan begins with step {first}; without a running plan it begins with step 0",
        )
    steps = [_step(step, first + offset, rule, to_odom) for offset, step in enumerate(plan.steps)]
    start = _start(plan, 1 - steps[0].foot, to_odom) if running is None else None
    _check_sequence(steps, start, rule)
    return steps if running is None else _merge(steps, running, rule)


def _merge(steps: list[PlannedStep], running: RunningPlan, rule: StepRule) -> list[PlannedStep]:
    """The steps of an update from the first that the running plan lets change.

    Both plans have one step of the same index and foot, which the update leaves where it is: planner and robot may have
    drifted apart since the running plan was made. The rest is moved with it, in the plane, in height and about the
    vertical, so that what was level stays level. An update may also go on behind the running plan's last step.
    """
    end = running.steps[-1].index
    if running.first_changeable < 0:
        raise _indices("the running plan is ending; no step of it can still be changed")
    at = max(running.first_changeable, steps[0].index)
    if at > end + 1:
        raise _indices(f"the update begins with step {at}, the running plan ends with step {end}: steps between lack")
    if steps[-1].index < at:
        raise _indices(
            f"the update ends with step {steps[-1].index}; of the running plan only step {at} and those behind it can "
            "still be changed"
        )
    common = min(at, end)
    before = running.step(at - 1)
    kept, own = running.step(common), next((step for step in steps if step.index == common), None)
    assert kept is not None
    if own is not None:
        if own.foot != kept.foot:
            raise _inconsistent(f"{own.name}: in the running plan this step is the {FEET[kept.foot]} foot's")
        move = own.sole.plane_to(kept.sole)
        steps = [replace(step, sole=kept.sole if step is own else move @ step.sole) for step in steps]
    merged = [step for step in steps if step.index >= at]
    _check_sequence(merged, before, rule)
    return merged


def _check_sequence(steps: Sequence[PlannedStep], before: PlannedStep | Pose | None, rule: StepRule) -> None:
    """Every step as seen from the other foot.

    Args:
        steps: one after the other.
        before: the step before them, or where the foot stands that stays during the first one; None: not known here,
            which leaves the first step to the Motion Manager.
        rule: of the robot.
    """
    for step in steps:
        if isinstance(before, Step):
            if step.foot == before.foot:
                raise _inconsistent(f"{step.name}: the {FEET[step.foot]} foot twice in a row; feet must alternate")
            before = before.sole
        if before is not None and (reason := rule.beside(step, before)):
            raise _invalid(reason)
        before = step


def _name(step: vigir.Step) -> str:
    foot = step.foot.foot_index
    return f"step {step.step_index} ({FEET[foot] if foot in (LEFT, RIGHT) else 'no foot'})"


def _start(plan: StepPlan, foot: int, to_odom: Pose | None) -> Pose | None:
    """Where a foot stands before step 0, if the planner says, which it does by naming a frame."""
    stands = plan.start.right if foot == RIGHT else plan.start.left
    if not (plan.start.header.frame_id or stands.header.frame_id):
        return None
    try:
        if stands.foot_index != foot:
            raise _inconsistent(f"start.{FEET[foot]} has foot index {stands.foot_index}; expected {foot}")
        return _pose(stands.pose, f"start.{FEET[foot]}", to_odom)
    except PlanError as error:
        raise PlanError(error.status, _E.ERR_INVALID_START, str(error)) from None


def _step(step: vigir.Step, index: int, rule: StepRule, to_odom: Pose | None) -> PlannedStep:
    """One step by itself: everything but its place relative to the other foot."""
    if step.step_index != index:
        raise _indices(f"step {step.step_index} stands where step {index} was expected")
    name = _name(step)
    if step.foot.foot_index not in (LEFT, RIGHT):
        raise _invalid(f"{name}: foot index {step.foot.foot_index}; expected 0 (left) or 1 (right)")
    if not step.valid:
        raise _invalid(f"{name}: its planner marked it as not valid")
    if step.colliding:
        raise _invalid(f"{name}: its planner marked it as colliding")
    sole = _pose(step.foot.pose, name, to_odom)
    planned = Step(index, step.foot.foot_index, sole, step.swing_height, step.step_duration, step.sway_duration)
    if reason := rule.alone(planned):
        raise _invalid(reason)
    return planned


def _pose(pose: geometry_msgs.msg.Pose, name: str, to_odom: Pose | None) -> Pose:
    p = (pose.position.x, pose.position.y, pose.position.z)
    given = Pose(p, _unit(pose.orientation, name))
    in_odom = given if to_odom is None else to_odom @ given
    if not all(map(math.isfinite, in_odom.position)):
        raise _invalid(f"{name}: position {p} is not finite")
    return in_odom


def _unit(q: geometry_msgs.msg.Quaternion, name: str) -> tuple[float, float, float, float]:
    w, x, y, z = q.w, q.x, q.y, q.z
    norm = math.hypot(w, x, y, z)
    if not abs(norm - 1.0) <= UNIT:
        raise _invalid(f"{name}: orientation has norm {norm:.6g}; expected 1")
    return w / norm, x / norm, y / norm, z / norm
