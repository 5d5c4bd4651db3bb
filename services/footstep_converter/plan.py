"""Conversion of ViGIR's step plans to the Motion System's footsteps, or rejection before anything is sent."""

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
"""Names of a step's numbers in ViGIR's messages."""
STAMP_TOLERANCE = 10.0  # between a plan's stamp and robot time [s]

_F, _E = FootstepExecutionStatus, ErrorStatus


class PlanRejectedError(RefusalError):
    """Rejected plan, with flags of FootstepExecutionStatus (``status``) and ErrorStatus (``error``)."""

    def __init__(self, status: int, error: int, text: str) -> None:
        super().__init__("plan", text)
        self.status = status
        self.error = error


def _invalid(text: str) -> PlanRejectedError:
    return PlanRejectedError(_F.ERR_INVALID_PLAN, _E.ERR_INVALID_STEP, text)


def _inconsistent(text: str) -> PlanRejectedError:
    return PlanRejectedError(_F.ERR_INCONSISTENT_STEP_PLAN, _E.ERR_INCONSISTENT_STEP_PLAN, text)


def _indices(text: str) -> PlanRejectedError:
    return PlanRejectedError(_F.ERR_INVALID_INCONSISTENT_INDICES, _E.ERR_INCONSISTENT_STEP_PLAN, text)


@dataclass(frozen=True)
class RunningPlan:
    """Plan that the Motion Manager executes."""

    steps: Sequence[PlannedStep]
    first_changeable: int  # step index, at most one after the last step's; -1: no step can be changed

    def step(self, index: int) -> PlannedStep | None:
        at = index - self.steps[0].index
        return self.steps[at] if 0 <= at < len(self.steps) else None

    def updated(self, steps: Sequence[PlannedStep]) -> list[PlannedStep]:
        """Plan after an accepted update: the steps before it, then the update."""
        return [step for step in self.steps if step.index < steps[0].index] + list(steps)


def check_size(plan: StepPlan, rule: StepRule) -> None:
    """Raise ``PlanRejectedError`` for no steps, or too many; before any work on them."""
    if not plan.steps:
        text = "the plan has no steps, and no plan runs that it could stop"
        raise PlanRejectedError(_F.ERR_EMPTY_PLAN, _E.ERR_INCONSISTENT_REQUEST, text)
    if len(plan.steps) > rule.limits.max_steps:
        text = f"the plan has {len(plan.steps)} steps; expected at most {rule.limits.max_steps}"
        raise PlanRejectedError(_F.ERR_INVALID_PLAN, _E.ERR_INVALID_PARAMETERS, text)


def stamp(plan: StepPlan, now: int) -> int:
    """Stamp of a plan [ns], 0: none; ``PlanRejectedError`` if it is not of the robot time ``now`` [ns], 0: unknown."""
    time: int = plan.header.stamp.sec * 10**9 + plan.header.stamp.nanosec
    age = (now - time) * 1e-9
    if time and now and abs(age) > STAMP_TOLERANCE:
        text = (
            f"the plan's stamp is {abs(age):.3f} s {'before' if age > 0 else 'after'} robot time ({now * 1e-9:.3f} s); "
            f"expected at most {STAMP_TOLERANCE:g} s, or 0. Is it of another clock?"
        )
        raise PlanRejectedError(_F.ERR_INCONSISTENT_STEP_PLAN, _E.ERR_INVALID_PARAMETERS, text)
    return time


def frame(plan: StepPlan) -> str:
    """Frame of a plan; ``PlanRejectedError`` if it names none, or a step or the start has another."""
    name: str = plan.header.frame_id
    if not name:
        raise _inconsistent("the plan has no frame; expected header.frame_id")
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
    """Steps of a plan to send.

    Args:
        plan: all poses in one frame, at the soles.
        rule: of the robot.
        running: plan to update. None: none runs, and the plan begins with step 0.
        to_odom: pose of the plan's frame in odom; None: it is odom.

    Returns:
        The complete plan; of an update, the steps from the first changed one, which keeps the running plan's pose.

    Raises:
        PlanRejectedError: with the step and the expected value.
    """
    check_size(plan, rule)
    frame(plan)
    first = plan.steps[0].step_index
    if running is None and first != 0:
        text = f"the plan begins with step {first}; expected step 0, as no plan runs"
        raise PlanRejectedError(_F.ERR_NON_ZERO_INITIAL_STEP, _E.ERR_INCONSISTENT_STEP_PLAN, text)
    steps = [_step(step, first + offset, rule, to_odom) for offset, step in enumerate(plan.steps)]
    start = _start(plan, 1 - steps[0].foot, to_odom) if running is None else None
    _check_sequence(steps, start, rule)
    return steps if running is None else _merge(steps, running, rule)


def _merge(steps: list[PlannedStep], running: RunningPlan, rule: StepRule) -> list[PlannedStep]:
    """Steps of an update from the first that the running plan allows to change, at most after its last step.

    The common step, of the same index and foot, keeps its pose: planner and robot may have drifted apart. The other
    steps move with it, in the plane, in height and about the vertical, so that level steps stay level.
    """
    end = running.steps[-1].index
    if running.first_changeable < 0:
        raise _indices("the running plan is ending; none of its steps can be changed")
    at = max(running.first_changeable, steps[0].index)
    if at > end + 1:
        raise _indices(
            f"the update begins with step {at}; expected at most {end + 1}, as the running plan ends with {end}"
        )
    if steps[-1].index < at:
        raise _indices(
            f"the update ends with step {steps[-1].index}; the running plan can only be changed from step {at} on"
        )
    common = min(at, end)
    before = running.step(at - 1)
    kept, own = running.step(common), next((step for step in steps if step.index == common), None)
    assert kept is not None
    if own is not None:
        if own.foot != kept.foot:
            raise _inconsistent(f"{own.name}: expected the {FEET[kept.foot]} foot, as in the running plan")
        move = own.sole.plane_to(kept.sole)
        steps = [replace(step, sole=kept.sole if step is own else move @ step.sole) for step in steps]
    merged = [step for step in steps if step.index >= at]
    _check_sequence(merged, before, rule)
    return merged


def _check_sequence(steps: Sequence[PlannedStep], before: PlannedStep | Pose | None, rule: StepRule) -> None:
    """Check each of successive steps relative to the other foot.

    ``before``: step before them, or pose of the standing foot during the first; None: the first is not checked here.
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
    """Pose of a foot before step 0; None if the planner names no frame for it."""
    stands = plan.start.right if foot == RIGHT else plan.start.left
    if not (plan.start.header.frame_id or stands.header.frame_id):
        return None
    try:
        if stands.foot_index != foot:
            raise _inconsistent(f"start.{FEET[foot]} has foot index {stands.foot_index}; expected {foot}")
        return _pose(stands.pose, f"start.{FEET[foot]}", to_odom)
    except PlanRejectedError as error:
        raise PlanRejectedError(error.status, _E.ERR_INVALID_START, str(error)) from None


def _step(step: vigir.Step, index: int, rule: StepRule, to_odom: Pose | None) -> PlannedStep:
    """Check one step, except relative to the other foot."""
    if step.step_index != index:
        raise _indices(f"step {step.step_index} at the position of step {index}")
    name = _name(step)
    if step.foot.foot_index not in (LEFT, RIGHT):
        raise _invalid(f"{name}: foot index {step.foot.foot_index}; expected 0 (left) or 1 (right)")
    if not step.valid:
        raise _invalid(f"{name}: marked as not valid by its planner")
    if step.colliding:
        raise _invalid(f"{name}: marked as colliding by its planner")
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
