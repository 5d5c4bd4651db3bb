"""From a ViGIR step plan to the Motion System's footsteps, or to the reason why not.

Everything is checked before anything is sent: `convert` returns the whole plan or raises. Displacements are those of
a sole seen from the other foot's sole, turned by that foot's heading: x forward, y left, z up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import geometry_msgs.msg
import numpy as np
from vigir_footstep_planning_msgs.msg import ErrorStatus, Foot, FootstepExecutionStatus, Step, StepPlan

from valor.common.errors import ValorError
from valor.common.messages import Footstep
from valor.common.poses import Pose
from valor.robot.motion_tables import Footsteps
from valor.robot.soles import outline, overlap
from valor.robot.tables import Feet

ODOM = "odom"
FEET = {Foot.LEFT: "left", Foot.RIGHT: "right"}

_UNIT = 1e-3  # how far a quaternion's norm may be from 1 and still be an orientation
_ROUNDING = 1e-6  # allowed beyond a limit: the durations of a plan are float32


class PlanError(ValorError):
    """A plan that the robot does not get.

    Attributes:
        status: flags of FootstepExecutionStatus.
        error: flags of ErrorStatus.
    """

    def __init__(self, status: int, error: int, text: str) -> None:
        super().__init__(text)
        self.status = status
        self.error = error


def _invalid(text: str) -> PlanError:
    return PlanError(FootstepExecutionStatus.ERR_INVALID_PLAN, ErrorStatus.ERR_INVALID_STEP, text)


def _inconsistent(text: str) -> PlanError:
    return PlanError(FootstepExecutionStatus.ERR_INCONSISTENT_STEP_PLAN, ErrorStatus.ERR_INCONSISTENT_STEP_PLAN, text)


def _indices(text: str) -> PlanError:
    return PlanError(
        FootstepExecutionStatus.ERR_INVALID_INCONSISTENT_INDICES, ErrorStatus.ERR_INCONSISTENT_STEP_PLAN, text
    )


@dataclass(frozen=True)
class Limits:
    """What the robot can step."""

    footsteps: Footsteps
    feet: Feet


@dataclass(frozen=True)
class PlannedStep:
    """A step, its sole in odom."""

    index: int
    foot: int
    sole: Pose
    swing_height: float  # [m]; 0: the robot's default
    swing_duration: float  # [s]; likewise
    transfer_duration: float  # of the double support before [s]; likewise

    @property
    def name(self) -> str:
        """As it is called in texts."""
        return f"step {self.index} ({FEET[self.foot]})"

    def footstep(self) -> Footstep:
        """As the Motion System takes it."""
        return Footstep(
            step_index=self.index,
            foot=self.foot,
            position_in_odom=np.array(self.sole.position),
            orientation_in_odom=np.array(self.sole.orientation),
            swing_height=self.swing_height,
            swing_duration=self.swing_duration,
            transfer_duration=self.transfer_duration,
        )

    def message(self) -> Step:
        """As the feedback shows it."""
        step = Step(step_index=self.index, valid=True)
        step.header.frame_id = step.foot.header.frame_id = ODOM
        step.foot.foot_index = self.foot
        p, q = step.foot.pose.position, step.foot.pose.orientation
        p.x, p.y, p.z = self.sole.position
        q.w, q.x, q.y, q.z = self.sole.orientation
        step.swing_height = self.swing_height
        step.step_duration, step.sway_duration = self.swing_duration, self.transfer_duration
        return step


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


def check_size(plan: StepPlan, limits: Limits) -> None:
    """Refuse a plan by its length alone, before any work on its steps.

    Raises:
        PlanError: no steps, or too many.
    """
    if not plan.steps:
        raise PlanError(
            FootstepExecutionStatus.ERR_EMPTY_PLAN,
            ErrorStatus.ERR_INCONSISTENT_REQUEST,
            "the plan has no steps, and no plan runs that it could stop",
        )
    if len(plan.steps) > limits.footsteps.max_steps:
        raise PlanError(
            FootstepExecutionStatus.ERR_INVALID_PLAN,
            ErrorStatus.ERR_INVALID_PARAMETERS,
            f"the plan has {len(plan.steps)} steps; the robot takes at most {limits.footsteps.max_steps}",
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
    plan: StepPlan, limits: Limits, running: RunningPlan | None = None, to_odom: Pose | None = None
) -> list[PlannedStep]:
    """The steps of a plan that shall be taken.

    Args:
        plan: from ROS; all poses in one frame, at the soles.
        limits: of the robot.
        running: what the plan is an update of. None: nothing runs, and the plan begins with step 0.
        to_odom: the plan's frame in odom; None: it is odom.

    Returns:
        The whole plan; of an update, the steps from the first that changes, moved so that this step stays where the
        running plan has it.

    Raises:
        PlanError: the plan is refused; names the step and what was expected.
    """
    check_size(plan, limits)
    frame(plan)
    first = plan.steps[0].step_index
    if running is None and first != 0:
        raise PlanError(
            FootstepExecutionStatus.ERR_NON_ZERO_INITIAL_STEP,
            ErrorStatus.ERR_INCONSISTENT_STEP_PLAN,
            f"the plan begins with step {first}; without a running plan it begins with step 0",
        )
    steps = [_step(step, first + offset, limits.footsteps, to_odom) for offset, step in enumerate(plan.steps)]
    start = _start(plan, 1 - steps[0].foot, to_odom) if running is None else None
    _check_sequence(steps, start, limits)
    return steps if running is None else _merge(steps, running, limits)


def _merge(steps: list[PlannedStep], running: RunningPlan, limits: Limits) -> list[PlannedStep]:
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
    _check_sequence(merged, before, limits)
    return merged


def _check_sequence(steps: Sequence[PlannedStep], before: PlannedStep | Pose | None, limits: Limits) -> None:
    """Every step as seen from the other foot.

    Args:
        steps: one after the other.
        before: the step before them, or where the foot stands that stays during the first one; None: not known here,
            which leaves the first step to the Motion Manager.
        limits: of the robot.
    """
    for step in steps:
        if isinstance(before, PlannedStep):
            if step.foot == before.foot:
                raise _inconsistent(f"{step.name}: the {FEET[step.foot]} foot twice in a row; feet must alternate")
            before = before.sole
        if before is not None:
            _check_reach(step, before, limits)
        before = step


def _name(step: Step) -> str:
    return f"step {step.step_index} ({FEET.get(step.foot.foot_index, 'no foot')})"


def _start(plan: StepPlan, foot: int, to_odom: Pose | None) -> Pose | None:
    """Where a foot stands before step 0, if the planner says, which it does by naming a frame."""
    stands = plan.start.right if foot == Foot.RIGHT else plan.start.left
    if not (plan.start.header.frame_id or stands.header.frame_id):
        return None
    try:
        if stands.foot_index != foot:
            raise _inconsistent(f"start.{FEET[foot]} has foot index {stands.foot_index}; expected {foot}")
        return _pose(stands.pose, f"start.{FEET[foot]}", to_odom)
    except PlanError as error:
        raise PlanError(error.status, ErrorStatus.ERR_INVALID_START, str(error)) from None


def _step(step: Step, index: int, limits: Footsteps, to_odom: Pose | None) -> PlannedStep:
    """One step by itself: everything but its place relative to the other foot."""
    if step.step_index != index:
        raise _indices(f"step {step.step_index} stands where step {index} was expected")
    name = _name(step)
    if step.foot.foot_index not in FEET:
        raise _invalid(f"{name}: foot index {step.foot.foot_index}; expected 0 (left) or 1 (right)")
    if not step.valid:
        raise _invalid(f"{name}: its planner marked it as not valid")
    if step.colliding:
        raise _invalid(f"{name}: its planner marked it as colliding")
    sole = _pose(step.foot.pose, name, to_odom)
    _within(name, "tilt of the sole", sole.tilt, (0.0, limits.max_tilt), "rad")
    height, swing, transfer = step.swing_height, step.step_duration, step.sway_duration
    _within(name, "swing_height", height, (0.0, limits.max_swing_height), "m")
    if swing != 0.0:
        _within(name, "step_duration", swing, (limits.min_swing_duration, limits.max_swing_duration), "s")
    if transfer != 0.0:
        bounds = (limits.min_transfer_duration, limits.max_transfer_duration)
        _within(name, "sway_duration", transfer, bounds, "s")
    return PlannedStep(index, step.foot.foot_index, sole, height, swing, transfer)


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
    if not abs(norm - 1.0) <= _UNIT:
        raise _invalid(f"{name}: orientation has norm {norm:.6g}; expected 1")
    return w / norm, x / norm, y / norm, z / norm


def _check_reach(step: PlannedStep, stance: Pose, limits: Limits) -> None:
    """A step while the other foot stands at ``stance``."""
    reach, name, sole = limits.footsteps, step.name, step.sole
    dx, dy, dz = (a - b for a, b in zip(sole.position, stance.position, strict=True))
    c, s = math.cos(stance.yaw), math.sin(stance.yaw)
    forward, left = c * dx + s * dy, c * dy - s * dx
    width = left if step.foot == Foot.LEFT else -left
    turn = math.remainder(sole.yaw - stance.yaw, math.tau)
    _within(name, "forward of the other foot", forward, (-reach.max_backward, reach.max_forward), "m")
    _within(name, "width between the feet", width, (reach.min_width, reach.max_width), "m")
    _within(name, "distance from the other foot", math.hypot(dx, dy), (0.0, reach.max_distance), "m")
    _within(name, "height above the other foot", dz, (-reach.max_down, reach.max_up), "m")
    _within(name, "turned from the other foot", turn, (-reach.max_yaw, reach.max_yaw), "rad")
    feet = (limits.feet.left, limits.feet.right)
    own, other = (
        outline(pose.position, pose.rotation, feet[foot]) for pose, foot in ((sole, step.foot), (stance, 1 - step.foot))
    )
    if overlap(own, other):
        raise _invalid(f"{name}: it would stand on the {FEET[1 - step.foot]} foot")


def _within(name: str, what: str, value: float, bounds: tuple[float, float], unit: str) -> None:
    low, high = bounds
    if not low - _ROUNDING <= value <= high + _ROUNDING:  # NaN is within nothing
        raise _invalid(f"{name}: {what} {value:.4g} {unit}; expected {low:g} to {high:g}")
