"""What the processes' loops did when, side by side on one clock: from the marks that they published."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from valor.analysis.errors import SignalError
from valor.common.arrays import FloatArray
from valor.common.trace import IDLE, Stage, Trace

Stages = npt.NDArray[np.uint8]
_NO_STAGES = (Stage.COLLECT, Stage.CORE)


@dataclass(frozen=True)
class Lane:
    """One service's loop, n stages one behind the other.

    Attributes:
        service: its name.
        stages: (n,) ``Stage``.
        start, end: (n,) monotonic [s].
        cpu: (n,) that the loop's thread used [s].
        sequence: (n,) of the Proprioceptor that a stage concerns; 0: none.
        collected: (m, 2) when the garbage collector began and ended [s].
        looked: (c,) when it was asked how long threads have waited for a core [s].
        waited: (c,) so long by then: the loop's thread and the network's together [s].
        cost: of being traced [s].
    """

    service: str
    stages: Stages
    start: FloatArray
    end: FloatArray
    cpu: FloatArray
    sequence: FloatArray
    collected: FloatArray
    looked: FloatArray
    waited: FloatArray
    cost: float

    @classmethod
    def of(cls, service: str, traces: Sequence[Trace]) -> Self:
        """From what a service published, in order.

        Raises:
            SignalError: it published nothing, or no stage.
        """
        kind = np.concatenate([trace.stages for trace in traces] or [np.zeros(0, np.uint8)])
        if np.count_nonzero(~np.isin(kind, _NO_STAGES)) < 2:
            raise SignalError(f"{service}: said nothing of what it does; expected a loop that marks its stages")
        at, cpu, value = (
            np.concatenate([getattr(trace, column) for trace in traces]) for column in ("at", "cpu", "value")
        )
        marks = ~np.isin(kind, _NO_STAGES)
        collect, core = kind == Stage.COLLECT, kind == Stage.CORE
        last = traces[-1]
        cost = np.count_nonzero(marks) * last.mark_cost + np.count_nonzero(core) * last.cycle_cost
        return cls(
            service=service,
            stages=kind[marks][1:],
            start=at[marks][:-1],
            end=at[marks][1:],
            cpu=np.diff(cpu[marks]),
            sequence=value[marks][1:],
            collected=np.column_stack((cpu[collect], at[collect])),
            looked=at[core],
            waited=cpu[core] + value[core],
            cost=cost + sum(trace.flush_cost for trace in traces),
        )

    @property
    def at_work(self) -> npt.NDArray[np.bool_]:
        """(n,) whether a stage is work, not waiting for something."""
        return ~np.isin(self.stages, list(IDLE))

    def work_within(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """(k,) how long the loop was at work in each of k spans that follow each other [s]."""
        return _overlap(self.start[self.at_work], self.end[self.at_work], start, end)

    def collected_within(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """(k,) how long the garbage collector ran in each of k spans [s]."""
        return _overlap(self.collected[:, 0], self.collected[:, 1], start, end)

    def waited_within(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """(k,) how long its threads waited for a core between the looks around each of k spans [s]."""
        if self.looked.size < 2:
            return np.zeros(len(start))
        before = np.clip(np.searchsorted(self.looked, start, side="right") - 1, 0, len(self.looked) - 1)
        after = np.clip(np.searchsorted(self.looked, end, side="left"), 0, len(self.looked) - 1)
        return np.asarray(self.waited[after] - self.waited[before])


def _overlap(starts: FloatArray, ends: FloatArray, first: FloatArray, last: FloatArray) -> FloatArray:
    """(k,) how much of spans that follow each other lies in each of k windows."""

    def until(moments: FloatArray) -> FloatArray:
        """How much of the spans lies before each moment."""
        if not starts.size:
            return np.zeros(len(moments))
        complete = np.concatenate(([0.0], np.cumsum(ends - starts)))
        index = np.searchsorted(starts, moments, side="right")
        open_ = np.where(index > 0, np.minimum(moments, ends[index - 1]) - ends[index - 1], 0.0)
        return np.asarray(complete[index] + open_)

    return until(last) - until(first)
