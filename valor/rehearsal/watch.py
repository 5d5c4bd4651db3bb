"""A closed loop that is looked at while it runs: how far it was from falling, and what it took."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from valor.common.arrays import FloatArray
from valor.rehearsal.closed_loop import ClosedLoop
from valor.rehearsal.legs import Legs
from valor.robot.description import RobotDescription

_AT_LIMIT = 0.999  # of an effort limit


@dataclass(frozen=True)
class Numbers:
    """What was seen of a rung.

    Attributes:
        tilt: largest, of the base from upright [rad].
        dcm_error: RMS, of the worst axis [m]; None: nothing controlled it.
        distance: of the base, from above [m].
        knee_margin: least, of a knee from its stops [rad]; None: it has none.
        at_limit: joint → share of the periods in which its torque was at the limit; those that ever were.
        unsolved: periods whose QP had no solution.
    """

    tilt: float
    dcm_error: float | None
    distance: float
    knee_margin: float | None
    at_limit: dict[str, float]
    unsolved: int

    def plain(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


class WatchedLoop(ClosedLoop):
    """Keeps what ``Numbers`` tells, from one ``begin`` to the next."""

    def __init__(self, robot: RobotDescription, legs: Legs, profile: str, seed: int = 0) -> None:
        super().__init__(robot, profile, seed)
        self._legs = legs
        self._limit = _AT_LIMIT * robot.effort_limit
        self.begin()

    def begin(self) -> None:
        """Forget what was seen."""
        self._start: FloatArray = self.plant.data.qpos[:2].copy()
        self._periods = 0
        self._tilt, self._knee_margin = 0.0, math.inf
        self._squares: FloatArray = np.zeros(3)
        self._at_limit: FloatArray = np.zeros(len(self.robot.joints))
        self._solved_until = self.command.qp_failures if self._started else 0

    @property
    def tilt(self) -> float:
        """Of the base from upright, now [rad]."""
        _, x, y, _ = self.plant.data.qpos[3:7].tolist()
        return math.acos(max(-1.0, 1.0 - 2.0 * (x * x + y * y)))

    def look(self) -> None:
        """At the plant as it is."""
        self._tilt = max(self._tilt, self.tilt)
        knees = self._legs.knees
        position = self.plant.joint_position[knees]
        margin = np.minimum(position - self.robot.lower[knees], self.robot.upper[knees] - position)
        self._knee_margin = min(self._knee_margin, float(margin.min()))

    def settle(self, seconds: float, posture: FloatArray | None = None) -> None:
        super().settle(seconds, posture)
        self.look()

    def step(self) -> None:
        super().step()
        self._periods += 1
        self.look()
        self._squares += np.square(self.state.dcm_in_odom - self.command.dcm_reference_in_odom)
        self._at_limit += np.abs(self.plant.actuators.effort) >= self._limit

    def numbers(self) -> Numbers:
        """What was seen since ``begin``."""
        periods = max(1, self._periods)
        shares = dict(zip(self.robot.joints, (self._at_limit / periods).tolist(), strict=True))
        return Numbers(
            tilt=self._tilt,
            dcm_error=float(np.sqrt(self._squares / periods).max()) if self._periods else None,
            distance=float(np.hypot(*(self.plant.data.qpos[:2] - self._start))),
            knee_margin=self._knee_margin if math.isfinite(self._knee_margin) else None,
            at_limit={name: share for name, share in shares.items() if share > 0},
            unsolved=self.command.qp_failures - self._solved_until if self._started else 0,
        )
