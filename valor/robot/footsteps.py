"""Footsteps and the rule for feasible ones, in plain floats: fifty are checked within one control period.

Displacements are of a sole relative to the other sole, in its heading: x forward, y left, z up.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import acos, atan2, cos, hypot, remainder, sin, tau
from typing import Generic, Protocol, TypeVar

from valor.common.arrays import FloatArray
from valor.robot.motion_tables import Footsteps
from valor.robot.soles import outline, overlap
from valor.robot.tables import Feet

LEFT, RIGHT = 0, 1
FEET = ("left", "right")
UNIT = 1e-3  # largest deviation of an orientation quaternion's norm from 1
_ROUNDING = 1e-6  # tolerance of limits: durations of a plan may be float32


class Sole(Protocol):
    """Pose of a sole in the common frame of a plan."""

    @property
    def position(self) -> Sequence[float] | FloatArray:
        """Position (3,) [m]."""

    @property
    def rotation(self) -> Sequence[Sequence[float]] | FloatArray:
        """Rotation (3, 3)."""


SoleT = TypeVar("SoleT", bound=Sole)


@dataclass(frozen=True)  # no slots: with them `Step[SolePose](…)` fails
class Step(Generic[SoleT]):
    """Footstep."""

    index: int
    foot: int  # LEFT or RIGHT
    sole: SoleT  # final pose, in odom
    swing_height: float  # [m]; 0: the robot's default
    swing_duration: float  # [s]; 0: the robot's default
    transfer_duration: float  # of the preceding double support [s]; 0: the robot's default
    adjustable: float = 0.0  # largest adjustment along each axis to keep balance [m]

    @property
    def name(self) -> str:
        """Name in messages."""
        return f"step {self.index} ({FEET[self.foot]})"


@dataclass(frozen=True, slots=True)
class StepRule:
    """Rule of feasible steps of a robot."""

    limits: Footsteps
    feet: Feet
    # Of swing height, swing duration and transfer duration in messages.
    terms: tuple[str, str, str] = ("swing_height", "swing_duration", "transfer_duration")

    def alone(self, step: Step[SoleT]) -> str:
        """Return why a step is infeasible anywhere, with the expected values; empty if feasible."""
        limits = self.limits
        tilt = acos(min(1.0, max(-1.0, float(step.sole.rotation[2][2]))))
        height, swing, transfer = self.terms
        checks = [
            ("tilt of the sole", tilt, 0.0, limits.max_tilt, "rad"),
            (height, step.swing_height, 0.0, limits.max_swing_height, "m"),
        ]
        if step.swing_duration != 0.0:
            checks.append((swing, step.swing_duration, limits.min_swing_duration, limits.max_swing_duration, "s"))
        if step.transfer_duration != 0.0:
            low, high = limits.min_transfer_duration, limits.max_transfer_duration
            checks.append((transfer, step.transfer_duration, low, high, "s"))
        return _fault(step.name, checks)

    def reach(self, step: Step[SoleT], other: Sole) -> str:
        """Return why a step is out of reach with the other foot at ``other``; empty if within reach."""
        limits, sole = self.limits, step.sole
        dx, dy, up = (float(a) - float(b) for a, b in zip(sole.position, other.position, strict=True))
        heading = _yaw(other)
        c, s = cos(heading), sin(heading)
        forward, left = c * dx + s * dy, c * dy - s * dx
        width = left if step.foot == LEFT else -left
        turn = remainder(_yaw(sole) - heading, tau)
        return _fault(
            step.name,
            [
                ("forward of the other foot", forward, -limits.max_backward, limits.max_forward, "m"),
                ("width between the feet", width, limits.min_width, limits.max_width, "m"),
                ("height above the other foot", up, -limits.max_down, limits.max_up, "m"),
                ("turned from the other foot", turn, -limits.max_yaw, limits.max_yaw, "rad"),
            ],
        )

    def beside(self, step: Step[SoleT], other: Sole) -> str:
        """Return why a step is infeasible with the other foot at ``other``; empty if feasible."""
        sole = step.sole
        distance = hypot(*(float(a) - float(b) for a, b in zip(sole.position[:2], other.position[:2], strict=True)))
        far = ("distance from the other foot", distance, 0.0, self.limits.max_distance, "m")
        if fault := self.reach(step, other) or _fault(step.name, [far]):
            return fault
        feet = (self.feet.left, self.feet.right)
        own = outline(sole.position, sole.rotation, feet[step.foot])
        if overlap(own, outline(other.position, other.rotation, feet[1 - step.foot])):
            return f"{step.name}: it would stand on the {FEET[1 - step.foot]} foot"
        return ""


def _yaw(sole: Sole) -> float:
    return atan2(sole.rotation[1][0], sole.rotation[0][0])


def _fault(name: str, checks: Sequence[tuple[str, float, float, float, str]]) -> str:
    """Return a message about the first value outside its bounds; empty if there is none."""
    for what, value, low, high, unit in checks:
        if not low - _ROUNDING <= value <= high + _ROUNDING:  # also rejects NaN
            return f"{name}: {what} {value:.4g} {unit}; expected {low:g} to {high:g}"
    return ""
