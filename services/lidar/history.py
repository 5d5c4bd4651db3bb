"""Recent configurations of the robot, and those between them."""

import math
from collections import deque

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray

GAP = 200_000_000  # Robot time without a configuration after which the older ones are discarded [ns]
_KEPT = 12


class History:
    """Configurations (n,): position [m] and orientation (w, x, y, z) of the base, then joint angles [rad]."""

    def __init__(self) -> None:
        self._times = deque[int](maxlen=_KEPT)
        self._found = deque[FloatArray](maxlen=_KEPT)

    def add(self, time: int, configuration: FloatArray) -> None:
        """Append a configuration (n,) at a robot time [ns]."""
        if self._times and not 0 < time - self._times[-1] < GAP:
            self._times.clear()
            self._found.clear()
        self._times.append(time)
        self._found.append(configuration)

    def covers(self, first: int, last: int) -> bool:
        """Return whether configurations surround the robot times [ns]."""
        return bool(self._times) and self._times[0] <= first and last <= self._times[-1]

    def at(self, times: npt.NDArray[np.int64]) -> FloatArray:
        """Return the configurations (k, n) at k robot times [ns]: linear, angles the shorter way.

        The first or last one before or after all; there must be two.
        """
        known, found = np.array(self._times), np.array(self._found)
        steps = np.diff(found, axis=0)
        opposite = np.einsum("ij,ij->i", found[1:, 3:7], found[:-1, 3:7]) < 0.0
        steps[opposite, 3:7] -= 2.0 * found[1:][opposite, 3:7]
        steps[:, 7:] = np.remainder(steps[:, 7:] + math.pi, math.tau) - math.pi
        before = np.clip(np.searchsorted(known, times, side="right") - 1, 0, len(steps) - 1)
        share = np.clip((times - known[before]) / (known[before + 1] - known[before]), 0.0, 1.0)
        mixed: FloatArray = found[before] + share[:, None] * steps[before]
        mixed[:, 3:7] /= np.linalg.norm(mixed[:, 3:7], axis=1, keepdims=True)
        return mixed
