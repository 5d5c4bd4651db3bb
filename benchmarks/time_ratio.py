"""How robot time ran against the wall's: period by period, from the Proprioceptors of a bag."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from valor.analysis.reading.bag import Bag
from valor.common.arrays import FloatArray
from valor.common.errors import ValorError
from valor.common.topics import PROPRIOCEPTOR

SECOND = 1.0  # the window of ``worst_second`` [s]


@dataclass(frozen=True)
class TimeRatio:
    """Robot time beside the wall's, n Proprioceptors.

    Attributes:
        wall: (n,) when each was published [s].
        robot: (n,) the robot time of each [s].
    """

    wall: FloatArray
    robot: FloatArray

    @classmethod
    def of(cls, bag: Bag | Path, start: float, end: float) -> Self:
        """Those of a bag that were published between two moments of the wall clock [s].

        Raises:
            BagError: the bag has no Proprioceptors.
            ValorError: fewer than two of them then.
        """
        series = Bag.of(bag)["/bifrost/" + PROPRIOCEPTOR.name]
        chosen = (series.sent >= start) & (series.sent <= end)
        if np.count_nonzero(chosen) < 2:
            raise ValorError(f"{PROPRIOCEPTOR.name}: fewer than two between {start:.3f} and {end:.3f} s")
        return cls(series.sent[chosen], series.time[chosen])

    @property
    def periods(self) -> FloatArray:
        """(n - 1,) from each to the next on the wall [s]."""
        return np.diff(self.wall)

    @property
    def nominal(self) -> float:
        """The control period: robot time from one to the next [s]."""
        return float(np.median(np.diff(self.robot)))

    @property
    def factor(self) -> float:
        """Robot time to wall time from the first to the last."""
        return float((self.robot[-1] - self.robot[0]) / (self.wall[-1] - self.wall[0]))

    @property
    def worst_second(self) -> float:
        """The least that any second had; of the whole, if that is shorter."""
        ends = np.searchsorted(self.wall, self.wall + SECOND)
        starts = np.flatnonzero(ends < len(self.wall))
        if not starts.size:
            return self.factor
        ends = ends[starts]
        factors = (self.robot[ends] - self.robot[starts]) / (self.wall[ends] - self.wall[starts])
        return float(factors.min())

    def lost_beyond(self, limit: float) -> float:
        """What the periods longer than a limit [s] had too much, in all [s]."""
        long = self.periods[self.periods > limit]
        return float(np.sum(long - self.nominal))
