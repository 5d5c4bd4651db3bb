"""A trajectory that is asked for, who waits for its end, and whether it keeps its tolerances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from valor.common.arrays import FloatArray
from valor.robot.commanded_limits import CommandedLimits
from valor.valor_ros_controller.trajectory.errors import ErrorCode, InvalidTrajectoryError
from valor.valor_ros_controller.trajectory.tolerances import Tolerances
from valor.valor_ros_controller.trajectory.waypoints import Waypoints
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface

CATCH_UP = 0.1
"""A stream of trajectories, each replacing the one before, may fall behind by this and is still followed [s]."""


@dataclass(frozen=True)
class Outcome:
    """What became of a goal."""

    code: ErrorCode
    text: str
    canceled: bool = False


class Goal(Protocol):
    """Somebody who waits for a trajectory to end."""

    def finish(self, outcome: Outcome) -> None:
        """It has ended."""

    def feedback(self, hw: ValorEscherHWInterface) -> None:
        """It goes on."""


@dataclass(frozen=True)
class TrajectoryRequest:
    """A checked trajectory; ``goal`` is ``None`` where nobody waits for its end."""

    waypoints: Waypoints
    start: int  # robot time [ns]; 0: when it is taken up
    path: Tolerances
    goal_tolerance: Tolerances
    goal_time: float  # [s]; 0: however late
    goal: Goal | None

    @property
    def late(self) -> float:
        """By how much it may be late if its first point is too far away for its time [s]."""
        return CATCH_UP if self.goal is None else 0.0

    def judge(
        self, limits: CommandedLimits, late: float, position_error: FloatArray, velocity_error: FloatArray
    ) -> Outcome | None:
        """Whether it has ended, and how.

        Args:
            limits: of the controller's n joints.
            late: robot time since the trajectory's end, negative before it [s].
            position_error: (n,) by which the joints are not where they shall be [rad or m].
            velocity_error: (n,) likewise [1/s].
        """
        if late < 0.0:
            if violation := self.path.violation(limits, position_error, velocity_error):
                text = f"Aborted due to path tolerance violation: {violation}"
                return Outcome(ErrorCode.PATH_TOLERANCE_VIOLATED, text)
            return None
        violation = self.goal_tolerance.violation(limits, position_error, velocity_error)
        if not violation:
            return Outcome(ErrorCode.SUCCESSFUL, "Goal successfully reached!")
        if self.goal_time and late > self.goal_time:
            text = f"Aborted due to goal_time_tolerance exceeding by {late:g} seconds: {violation}"
            return Outcome(ErrorCode.GOAL_TOLERANCE_VIOLATED, text)
        return None


def stated(
    default: Tolerances, entries: Sequence[tuple[str, float, float]], names: Sequence[str], which: str
) -> Tolerances:
    """The tolerances of a goal: (joint, position, velocity) each; 0: the default, -1: not checked.

    Args:
        default: (n,) of the controller's joints.
        entries: what the goal states.
        names: (n,) of the joints.
        which: name of the entries, for the error's text.

    Raises:
        InvalidTrajectoryError: an unknown joint, or a number that is none of these.
    """
    position, velocity = default.position.copy(), default.velocity.copy()
    for name, *values in entries:
        if name not in names:
            text = f"{which} names {name!r}, which is none of {', '.join(names)}"
            raise InvalidTrajectoryError(text)
        joint = names.index(name)
        for field, target, value in zip(("position", "velocity"), (position, velocity), values, strict=True):
            if not np.isfinite(value) or (value < 0 and value != -1):
                text = f"{which} of {name}: {field} is {value:g}; expected positive, 0 (default) or -1 (unchecked)"
                raise InvalidTrajectoryError(text)
            if value:
                target[joint] = np.inf if value < 0 else value
    return Tolerances(position, velocity)
