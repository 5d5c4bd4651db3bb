"""From a ViGIR step plan to the Motion System's footsteps, or to the reason why not.

Everything is checked before anything is sent: `convert` returns the whole plan or raises. Displacements are those of
a sole seen from the other foot's sole, turned by that foot's heading: x forward, y left, z up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from geometry_msgs.msg import Pose, Quaternion
from vigir_footstep_planning_msgs.msg import ErrorStatus, Foot, FootstepExecutionStatus, Step, StepPlan

from valor_common.errors import ValorError
from valor_common.messages import Footstep
from valor_common.robot import Footsteps

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
class RunningPlan:
    """The plan that the Motion Manager executes."""

    steps: Sequence[Footstep]
    first_changeable: int  # step index; -1: none

    def updated(self, steps: Sequence[Footstep]) -> list[Footstep]:
        """The plan after an accepted update: what comes before it, then the update."""
        return [step for step in self.steps if step.step_index < steps[0].step_index] + list(steps)


@dataclass(frozen=True)
class Sole:
    """Where a sole stands in odom."""

    foot: int
    position: tuple[float, float, float]  # [m]
    orientation: tuple[float, float, float, float]  # (w, x, y, z), of norm 1

    @property
    def yaw(self) -> float:
        """Heading [rad]."""
        w, x, y, z = self.orientation
        return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))

    @property
    def tilt(self) -> float:
        """Angle between the sole's z axis and the vertical [rad]."""
        _, x, y, _ = self.orientation
        return math.acos(max(-1.0, 1.0 - 2.0 * (x * x + y * y)))

    @classmethod
    def of(cls, step: Footstep) -> Sole:
        """The sole at the end of a step."""
        x, y, z = step.position_in_odom.tolist()
        qw, qx, qy, qz = step.orientation_in_odom.tolist()
        return cls(step.foot, (x, y, z), (qw, qx, qy, qz))


def convert(plan: StepPlan, limits: Footsteps, running: RunningPlan | None = None) -> list[Footstep]:
    """The steps of a plan, as the Motion System takes them.

    Args:
        plan: from ROS; all poses in the frame `odom`, at the soles.
        limits: of the robot.
        running: what the plan is an update of. None: nothing runs, and the plan begins with step 0.

    Raises:
        PlanError: the plan is refused; names the step and what was expected.
    """
    steps = plan.steps
    if not steps:
        raise PlanError(
            FootstepExecutionStatus.ERR_EMPTY_PLAN,
            ErrorStatus.ERR_INCONSISTENT_REQUEST,
            "the plan has no steps, and no plan runs that it could stop",
        )
    if len(steps) > limits.max_steps:
        raise PlanError(
            FootstepExecutionStatus.ERR_INVALID_PLAN,
            ErrorStatus.ERR_INVALID_PARAMETERS,
            f"the plan has {len(steps)} steps; the robot takes at most {limits.max_steps}",
        )
    if plan.header.frame_id != ODOM:
        raise _inconsistent(
            f"the plan is in frame {plan.header.frame_id!r}; only {ODOM!r} is accepted, transform it first"
        )
    first = steps[0].step_index
    stance = _start(plan, steps[0]) if running is None else _stance_of_update(steps[0], running)
    converted = []
    for offset, step in enumerate(steps):
        footstep = _convert_step(step, first + offset, limits)
        sole = Sole.of(footstep)
        if stance is not None:
            _check_reach(_name(step), sole, stance, limits)
        converted.append(footstep)
        stance = sole
    return converted


def _name(step: Step) -> str:
    return f"step {step.step_index} ({FEET.get(step.foot.foot_index, 'no foot')})"


def _start(plan: StepPlan, first: Step) -> Sole | None:
    """Where the robot stands while step 0 swings, if the planner says."""
    if first.step_index != 0:
        raise PlanError(
            FootstepExecutionStatus.ERR_NON_ZERO_INITIAL_STEP,
            ErrorStatus.ERR_INCONSISTENT_STEP_PLAN,
            f"the plan begins with step {first.step_index}; without a running plan it begins with step 0",
        )
    stance = plan.start.right if first.foot.foot_index == Foot.LEFT else plan.start.left
    frames = {plan.start.header.frame_id, stance.header.frame_id} - {""}
    if not frames:
        return None
    if frames != {ODOM}:
        raise _inconsistent(f"the start feet are in frame {min(frames - {ODOM})!r}; only {ODOM!r} is accepted")
    expected = Foot.RIGHT if first.foot.foot_index == Foot.LEFT else Foot.LEFT
    if stance.foot_index != expected:
        raise _inconsistent(f"start.{FEET[expected]} has foot index {stance.foot_index}; expected {expected}")
    position, orientation = _pose(stance.pose, f"start.{FEET[expected]}")
    return Sole(expected, position, orientation)


def _stance_of_update(first: Step, running: RunningPlan) -> Sole | None:
    """Where the robot will stand while the first step of an update swings."""
    before = None
    for step in running.steps:
        if step.step_index == first.step_index >= running.first_changeable >= 0:
            if step.foot != first.foot.foot_index:
                raise _inconsistent(f"{_name(first)}: in the running plan this step is the {FEET[step.foot]} foot's")
            return None if before is None else Sole.of(before)
        before = step
    changeable = [step.step_index for step in running.steps if step.step_index >= running.first_changeable >= 0]
    can = f"steps {changeable[0]} to {changeable[-1]}" if changeable else "no step"
    raise _indices(f"the update begins with step {first.step_index}; of the running plan {can} can still be changed")


def _convert_step(step: Step, index: int, limits: Footsteps) -> Footstep:
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
    for frame in (step.header.frame_id, step.foot.header.frame_id):
        if frame not in ("", ODOM):
            raise _inconsistent(f"{name}: in frame {frame!r}, the plan in {ODOM!r}")
    position, orientation = _pose(step.foot.pose, name)
    sole = Sole(step.foot.foot_index, position, orientation)
    _within(name, "tilt of the sole", sole.tilt, (0.0, limits.max_tilt), "rad")
    height, swing, transfer = step.swing_height, step.step_duration, step.sway_duration
    _within(name, "swing_height", height, (0.0, limits.max_swing_height), "m")
    if swing != 0.0:
        _within(name, "step_duration", swing, (limits.min_swing_duration, limits.max_swing_duration), "s")
    if transfer != 0.0:
        bounds = (limits.min_transfer_duration, limits.max_transfer_duration)
        _within(name, "sway_duration", transfer, bounds, "s")
    return Footstep(
        step_index=index,
        foot=sole.foot,
        position_in_odom=np.array(position),
        orientation_in_odom=np.array(orientation),
        swing_height=height,
        swing_duration=swing,
        transfer_duration=transfer,
    )


def _pose(pose: Pose, name: str) -> tuple[tuple[float, float, float], tuple[float, float, float, float]]:
    p = (pose.position.x, pose.position.y, pose.position.z)
    if not all(math.isfinite(value) for value in p):
        raise _invalid(f"{name}: position {p} is not finite")
    return p, _unit(pose.orientation, name)


def _unit(q: Quaternion, name: str) -> tuple[float, float, float, float]:
    w, x, y, z = q.w, q.x, q.y, q.z
    norm = math.hypot(w, x, y, z)
    if not abs(norm - 1.0) <= _UNIT:
        raise _invalid(f"{name}: orientation has norm {norm:.6g}; expected 1")
    return w / norm, x / norm, y / norm, z / norm


def _check_reach(name: str, sole: Sole, stance: Sole, limits: Footsteps) -> None:
    if sole.foot == stance.foot:
        raise _inconsistent(f"{name}: the {FEET[sole.foot]} foot twice in a row; feet must alternate")
    dx, dy, dz = (a - b for a, b in zip(sole.position, stance.position, strict=True))
    c, s = math.cos(stance.yaw), math.sin(stance.yaw)
    forward, left = c * dx + s * dy, c * dy - s * dx
    width = left if sole.foot == Foot.LEFT else -left
    turn = math.remainder(sole.yaw - stance.yaw, math.tau)
    _within(name, "forward of the other foot", forward, (-limits.max_backward, limits.max_forward), "m")
    _within(name, "width between the feet", width, (limits.min_width, limits.max_width), "m")
    _within(name, "height above the other foot", dz, (-limits.max_down, limits.max_up), "m")
    _within(name, "turned from the other foot", turn, (-limits.max_yaw, limits.max_yaw), "rad")


def _within(name: str, what: str, value: float, bounds: tuple[float, float], unit: str) -> None:
    low, high = bounds
    if not low - _ROUNDING <= value <= high + _ROUNDING:  # NaN is within nothing
        raise _invalid(f"{name}: {what} {value:.4g} {unit}; expected {low:g} to {high:g}")
