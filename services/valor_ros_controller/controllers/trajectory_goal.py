"""Trajectory requests: their goals, tolerances and outcomes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from valor.common.arrays import FloatArray
from valor.robot.commanded_limits import CommandedLimits
from valor.valor_ros_controller.trajectory.waypoints import ErrorCode, InvalidTrajectoryError, Tolerances, Waypoints
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface

CATCH_UP = 0.1
"""Largest delay of a stream, trajectories without goals that each replace the one before [s]."""


@dataclass(frozen=True)
class TrajectoryOutcome:
    """Outcome of a goal."""

    code: ErrorCode
    text: str
    canceled: bool = False


class TrajectoryGoal(Protocol):
    """Client that waits for the end of a trajectory."""

    def finish(self, outcome: TrajectoryOutcome) -> None:
        """Send the outcome."""

    def feedback(self, hw: ValorEscherHWInterface) -> None:
        """Send feedback."""


@dataclass(frozen=True)
class TrajectoryRequest:
    """Checked trajectory; ``goal`` is None if no client waits for its end."""

    waypoints: Waypoints
    start: int  # robot time [ns]; 0: when it starts to execute
    path: Tolerances
    goal_tolerance: Tolerances
    goal_time: float  # largest delay of the goal [s]; 0: unlimited
    goal: TrajectoryGoal | None

    @property
    def late(self) -> float:
        """Allowed delay if the first point is too far away for its time [s]."""
        return CATCH_UP if self.goal is None else 0.0

    def judge(
        self, limits: CommandedLimits, late: float, position_error: FloatArray, velocity_error: FloatArray
    ) -> TrajectoryOutcome | None:
        """Outcome of the trajectory; None if it continues.

        ``late``: robot time since its end, negative before it [s]. Errors (n,): desired minus measured [rad or m, 1/s].
        """
        if late < 0.0:
            if violation := self.path.violation(limits, position_error, velocity_error):
                text = f"Aborted due to path tolerance violation: {violation}"
                return TrajectoryOutcome(ErrorCode.PATH_TOLERANCE_VIOLATED, text)
            return None
        violation = self.goal_tolerance.violation(limits, position_error, velocity_error)
        if not violation:
            return TrajectoryOutcome(ErrorCode.SUCCESSFUL, "Goal successfully reached!")
        if self.goal_time and late > self.goal_time:
            text = f"Aborted due to goal_time_tolerance exceeding by {late:g} seconds: {violation}"
            return TrajectoryOutcome(ErrorCode.GOAL_TOLERANCE_VIOLATED, text)
        return None


def stated(default: Tolerances, entries: Iterable[Any], names: Sequence[str], which: str) -> Tolerances:
    """Tolerances of a goal with entries ``JointTolerance``; 0: default, -1: not checked.

    ``names``: (n,) of the joints; ``which``: field of the entries, for error texts.

    Raises:
        InvalidTrajectoryError: an unknown joint, or another negative number.
    """
    tolerances = {"position": default.position.copy(), "velocity": default.velocity.copy()}
    for entry in entries:
        if entry.name not in names:
            raise InvalidTrajectoryError(f"{which} names {entry.name!r}; expected one of {', '.join(names)}")
        for field, target in tolerances.items():
            value = getattr(entry, field)
            if not np.isfinite(value) or (value < 0 and value != -1):
                text = (
                    f"{which} of {entry.name}: {field} is {value:g}; expected positive, 0 (default) or -1 (unchecked)"
                )
                raise InvalidTrajectoryError(text)
            if value:
                target[names.index(entry.name)] = np.inf if value < 0 else value
    return Tolerances(**tolerances)
