"""What a footstep is, and which a robot can take: one rule, for whoever plans steps and for who takes them.

Displacements are those of a sole seen from the other foot's sole, turned by that foot's heading: x forward, y left,
z up. Python floats, for a plan of fifty steps is checked between two periods of control.
"""

from __future__ import annotations

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
UNIT = 1e-3  # how far a quaternion's norm may be from 1 and still be an orientation
_ROUNDING = 1e-6  # allowed beyond a limit: the durations of a plan may be float32


class Sole(Protocol):
    """Where a sole is: its frame in the frame that all soles of a plan are in."""

    @property
    def position(self) -> Sequence[float] | FloatArray:
        """(3,) [m]."""

    @property
    def rotation(self) -> Sequence[Sequence[float]] | FloatArray:
        """(3, 3)."""


SoleT = TypeVar("SoleT", bound=Sole)


@dataclass(frozen=True)  # no slots: with them `Step[SolePose](…)` fails
class Step(Generic[SoleT]):
    """One step."""

    index: int
    foot: int  # LEFT or RIGHT
    sole: SoleT  # where it ends, in odom
    swing_height: float  # [m]; asked for as 0: the robot's own
    swing_duration: float  # [s]; likewise
    transfer_duration: float  # of the double support before [s]; likewise
    adjustable: float = 0.0  # how far the robot may move it, either way along each axis, to keep its balance [m]

    @property
    def name(self) -> str:
        """As it is called in texts."""
        return f"step {self.index} ({FEET[self.foot]})"


@dataclass(frozen=True, slots=True)
class StepRule:
    """What the steps of a robot have to keep.

    Attributes:
        limits: of steps.
        feet: the robot's.
        terms: what swing height, swing duration and transfer duration are called where steps come from.
    """

    limits: Footsteps
    feet: Feet
    terms: tuple[str, str, str] = ("swing_height", "swing_duration", "transfer_duration")

    def alone(self, step: Step[SoleT]) -> str:
        """Why a step cannot be taken anywhere, with the values expected; an empty text: it can."""
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
        """Why a step is out of reach while the other foot stands at ``other``; an empty text: it is not."""
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
        """Why a step cannot be taken while the other foot stands at ``other``; an empty text: it can."""
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
    """Heading of the x axis [rad]."""
    return atan2(sole.rotation[1][0], sole.rotation[0][0])


def _fault(name: str, checks: Sequence[tuple[str, float, float, float, str]]) -> str:
    """The first value that is not between its bounds."""
    for what, value, low, high, unit in checks:
        if not low - _ROUNDING <= value <= high + _ROUNDING:  # NaN is within nothing
            return f"{name}: {what} {value:.4g} {unit}; expected {low:g} to {high:g}"
    return ""
