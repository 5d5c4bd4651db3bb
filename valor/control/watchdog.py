"""Watchdog of Proprioceptor: validity of each message, and its continuity with the one before."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter

import casadi as ca
import numpy as np

from valor.common.kernel import Expression, Kernel, pieces
from valor.common.messages import Proprioceptor

LONGEST_GAP = 0.1  # Longest robot time between two Proprioceptors under control [s]

_VECTORS = (
    ("joint_position", None), ("joint_velocity", None), ("joint_effort", None),
    ("imu_orientation", 4), ("imu_angular_velocity", 3), ("imu_linear_acceleration", 3),
    ("left_foot_wrench", 6), ("right_foot_wrench", 6), ("left_hand_wrench", 6), ("right_hand_wrench", 6),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Gap:
    """Discontinuity between two Proprioceptors."""

    reason: str
    same_world: bool  # the robot under control so far, whose time has advanced


class ProprioceptorWatchdog:
    """Checks each Proprioceptor by itself and, by robot time, against the one before: a simulation may pause."""

    def __init__(self, joints: int) -> None:
        self._sizes = tuple(joints if size is None else size for _, size in _VECTORS)
        self._vectors = attrgetter(*(name for name, _ in _VECTORS))
        self._numbers, self._squares = np.zeros(sum(self._sizes)), np.zeros(2)
        self._look = Kernel("watchdog", self._expressions, (self._numbers,), (self._squares,))
        self._time: int | None = None
        self._sequence = 0
        self.missed = 0  # Proprioceptors lost between two received ones, since start
        self.malformed = 0  # consecutive invalid ones

    def fault(self, proprioceptor: Proprioceptor) -> str:
        """Return the fault of a Proprioceptor; an empty string if it is valid."""
        vectors = self._vectors(proprioceptor)
        if tuple(map(len, vectors)) != self._sizes:
            for (name, _), vector, size in zip(_VECTORS, vectors, self._sizes, strict=True):
                if len(vector) != size:
                    return self._malformed(f"{name} has {len(vector)} numbers; expected {size}")
        # A sum of squares is finite if its terms are: two calls check all vectors.
        np.concatenate(vectors, out=self._numbers)
        self._look()
        squares, norm = self._squares.tolist()
        if not math.isfinite(squares):
            for (name, _), vector in zip(_VECTORS, vectors, strict=True):
                if not math.isfinite(vector.dot(vector)):
                    return self._malformed(f"{name} is not finite")
            return self._malformed("its numbers are too large to be true")
        if abs(norm - 1.0) > 0.01:
            return self._malformed("imu_orientation is no unit quaternion")
        self.malformed = 0
        return ""

    def _expressions(self, numbers: Expression) -> Sequence[Expression]:
        """(2,) sums of squares of all numbers, and of the attitude."""
        vectors = dict(zip((name for name, _ in _VECTORS), pieces(numbers, self._sizes), strict=True))
        return [ca.vertcat(ca.sumsqr(numbers), ca.sumsqr(vectors["imu_orientation"]))]

    def _malformed(self, reason: str) -> str:
        self.malformed += 1
        return reason

    def repeated(self, proprioceptor: Proprioceptor) -> bool:
        """Return whether this is the last one again: a simulation repeats it while waiting for its first Motor."""
        return proprioceptor.sequence == self._sequence and proprioceptor.time == self._time

    def discontinuity(self, proprioceptor: Proprioceptor) -> Gap | None:
        """Return the discontinuity between this Proprioceptor and the last; None without one, or for the first."""
        time, sequence = self._time, self._sequence
        self._time, self._sequence = proprioceptor.time, proprioceptor.sequence
        if time is None:
            return None
        if proprioceptor.sequence <= sequence or proprioceptor.time <= time:
            return Gap(
                f"another world: Proprioceptor went from {time * 1e-9:.3f} s, number {sequence}, "
                f"to {proprioceptor.time * 1e-9:.3f} s, number {proprioceptor.sequence}",
                same_world=False,
            )
        self.missed += proprioceptor.sequence - sequence - 1
        gap = (proprioceptor.time - time) * 1e-9
        if gap > LONGEST_GAP:
            reason = f"no Proprioceptor for {gap:.3f} s of robot time; expected at most {LONGEST_GAP} s"
            return Gap(reason, same_world=True)
        return None
