"""One control period through all processes: of what its time consists, and who makes the world wait.

A period lasts from one Proprioceptor to the next. Its segments follow one another without a rest: the Comms Manager's
stages, and where it waits for the Motor, the way there and back and the Motion Manager's stages.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from valor.analysis.errors import SignalError
from valor.analysis.lanes import Lane
from valor.common.arrays import FloatArray
from valor.common.trace import Stage

COMMS, MOTION = "comms_manager", "motion_manager"
LATE = 1.1  # periods longer than so much of the nominal one are late
TO_MOTION, TO_COMMS = "Proprioceptor → Motion Manager", "Motor → Comms Manager"
SLEEP, OVERSLEEP = "sleeps until due", "wakes after that"
_NEGLIGIBLE = 1e-5  # blame that is not told [s]
WITHOUT_CORE, COLLECTING, LONGER = "waits for a core", "collects garbage", "takes longer"
_NAMES = {  # by the stage that a segment is; their order in a period
    Stage.AWAIT_MOTOR: "waits for Motor",
    Stage.PHYSICS: "physics",
    Stage.DEVICES: "devices",
    Stage.MEASURE: "measures",
    Stage.ATTEND: "clock, truth, statistics",
    Stage.SLEEP: SLEEP,
    Stage.OVERSLEEP: OVERSLEEP,
    Stage.PUBLISH: "sends Proprioceptor",
}
_TICK = {  # the Motion Manager's within its answer
    Stage.DECODE: "decodes",
    Stage.TAKE_COMMANDS: "takes commands",
    Stage.CONTROL: "control",
    Stage.SEND_MOTOR: "sends Motor",
}
_WAITING = (_NAMES[Stage.AWAIT_MOTOR], SLEEP)  # what lasts as long as others make it last


@dataclass(frozen=True)
class Segment:
    """A part of all n periods.

    Attributes:
        service: whose it is; empty: the way between two.
        start, end: (n,) monotonic [s]; equal where a period has no such part.
        duration: (n,) of all its parts in a period [s].
        without_core: (n,) of that, ready to run and not running [s].
        collecting: (n,) of that, in Python's garbage collector [s].
    """

    service: str
    name: str
    start: FloatArray
    end: FloatArray
    duration: FloatArray
    without_core: FloatArray
    collecting: FloatArray

    @property
    def title(self) -> str:
        """Whose and what."""
        return f"{self.service}: {self.name}" if self.service else self.name


@dataclass(frozen=True)
class Blame:
    """What made late periods late.

    Attributes:
        title: of the segment.
        cause: why it took longer than usual.
        delay: of all late periods together [s].
        periods: in which it was at least a tenth of the delay.
        beside: how much of the time other services were at work, by their names.
    """

    title: str
    cause: str
    delay: float
    periods: int
    beside: dict[str, float]


@dataclass(frozen=True)
class Periods:
    """n control periods.

    Attributes:
        lanes: of all services that were heard, by name.
        start: (n,) when each Proprioceptor was sent, monotonic [s].
        length: (n,) until the next [s].
        nominal: [s].
        segments: of which they consist, in order.
    """

    lanes: dict[str, Lane]
    start: FloatArray
    length: FloatArray
    nominal: float
    segments: list[Segment]

    @classmethod
    def of(cls, lanes: dict[str, Lane], nominal: float) -> Self:
        """From the lanes of the services.

        Raises:
            SignalError: the Comms Manager's is missing, or has fewer than three periods.
        """
        comms = lanes.get(COMMS)
        if comms is None:
            raise SignalError(f"{COMMS}: said nothing; expected the marks of its loop")
        ends = np.flatnonzero(comms.stages == Stage.PUBLISH)
        if len(ends) < 4:
            raise SignalError(f"{COMMS}: {len(ends)} Proprioceptors; expected at least 4")
        start, length = comms.end[ends[:-1]], np.diff(comms.end[ends])
        segments = [
            segment
            for stage, name in _NAMES.items()
            for segment in (_answer(lanes, comms, ends) if stage is Stage.AWAIT_MOTOR and MOTION in lanes else [])
            + [_segment(comms, stage, name, ends)]
        ]
        return cls(lanes, start, length, nominal, _without_answered_wait(segments))

    @property
    def late(self) -> npt.NDArray[np.bool_]:
        """(n,) which are."""
        return self.length > LATE * self.nominal

    @property
    def factor(self) -> float:
        """Robot time to wall time."""
        return float(self.nominal * len(self.length) / self.length.sum())

    def describe(self) -> str:
        """How many, and how robot time ran."""
        return (
            f"{len(self.length)} periods of {1e3 * self.nominal:g} ms: robot time ran at {self.factor:.3f} of "
            f"the wall's, {100 * np.mean(self.late):.1f} % of periods were more than a tenth too long"
        )

    def example(self, percentile: float) -> int:
        """The period whose length is nearest to a percentile of all: 100 is the longest."""
        return int(np.argmin(np.abs(self.length - np.percentile(self.length, percentile))))

    def ranking(self) -> list[Blame]:
        """Who made the world wait, the worst first.

        What a late period has too much is shared out among its segments by how much longer than usual (the median)
        each of them was, and each one's share by what is known of why.
        """
        late = np.flatnonzero(self.late)
        if not late.size:
            return []
        guilty = [segment for segment in self.segments if segment.name not in _WAITING]
        excess = np.array([np.maximum(0.0, s.duration[late] - np.median(s.duration)) for s in guilty])
        delay = (self.length[late] - self.nominal) * excess / np.maximum(excess.sum(axis=0), 1e-12)
        blames = []
        for segment, own, share in zip(guilty, excess, delay, strict=True):
            collecting = np.minimum(segment.collecting[late], own)
            waiting = np.minimum(segment.without_core[late], own - collecting)
            for cause, part in (
                (WITHOUT_CORE, waiting),
                (COLLECTING, collecting),
                (LONGER, own - waiting - collecting),
            ):
                seconds = share * part / np.maximum(own, 1e-12)
                if (total := float(seconds.sum())) < _NEGLIGIBLE:
                    continue
                counted = int(np.count_nonzero(seconds > 0.1 * (self.length[late] - self.nominal)))
                blames.append(Blame(segment.title, cause, total, counted, self._beside(segment, late, seconds)))
        return sorted(blames, key=lambda blame: -blame.delay)

    def _beside(self, segment: Segment, late: npt.NDArray[np.intp], weight: FloatArray) -> dict[str, float]:
        """Which other services were at work meanwhile: share of the time, weighted."""
        start, end = segment.start[late], segment.end[late]
        shares = {}
        for name, lane in self.lanes.items():
            if name in (segment.service, COMMS) or (not segment.service and name == MOTION):
                continue
            share = lane.work_within(start, end) / np.maximum(end - start, 1e-9)
            shares[name] = float(np.average(share, weights=weight))
        return {name: share for name, share in shares.items() if share >= 0.05}


def _segment(lane: Lane, stage: Stage, name: str, ends: npt.NDArray[np.intp]) -> Segment:
    """A stage of the Comms Manager's, summed within each period; where it is there twice, it spans what is between."""
    chosen = lane.stages == stage
    rows = np.flatnonzero(chosen)
    rows = rows[(rows > ends[0]) & (rows <= ends[-1])]
    period = np.searchsorted(ends, rows, side="left") - 1
    n = len(ends) - 1
    duration, used = np.zeros(n), np.zeros(n)
    np.add.at(duration, period, (lane.end - lane.start)[rows])
    np.add.at(used, period, lane.cpu[rows])
    start, end = np.full(n, np.inf), np.full(n, -np.inf)
    np.minimum.at(start, period, lane.start[rows])
    np.maximum.at(end, period, lane.end[rows])
    absent = ~np.isfinite(start)
    start[absent] = end[absent] = lane.end[ends[:-1]][absent]
    waiting = duration if stage is Stage.OVERSLEEP else np.maximum(0.0, duration - used)
    if stage in (Stage.AWAIT_MOTOR, Stage.SLEEP):
        waiting = np.zeros(n)
    return Segment(lane.service, name, start, end, duration, waiting, lane.collected_within(start, end))


def _answer(lanes: dict[str, Lane], comms: Lane, ends: npt.NDArray[np.intp]) -> list[Segment]:
    """The way to the Motion Manager, its stages, and the way back, where the Comms Manager waited for them."""
    motion = lanes[MOTION]
    start, sequence = comms.end[ends[:-1]], comms.sequence[ends[:-1]]
    first = ends[:-1] + 1  # the stage behind the sending: waiting, in lockstep
    waited = comms.stages[first] == Stage.AWAIT_MOTOR
    sent = np.flatnonzero(motion.stages == Stage.SEND_MOTOR)
    sent = sent[sent >= len(_TICK)]
    if not sent.size:
        return []
    found = np.clip(np.searchsorted(motion.sequence[sent], sequence), 0, len(sent) - 1)
    row = sent[found]
    woken, back = motion.start[row - len(_TICK) + 1], comms.end[first]
    answered = waited & (motion.sequence[row] == sequence) & (motion.end[row] <= back) & (woken >= start)

    def span(
        name: str, service: str, begin: FloatArray, end: FloatArray, without_core: FloatArray | None = None
    ) -> Segment:
        begin, end = np.where(answered, begin, start), np.where(answered, end, start)
        idle = np.zeros(len(start)) if without_core is None else np.where(answered, without_core, 0.0)
        collecting = motion.collected_within(begin, end) if service else np.zeros(len(start))
        return Segment(service, name, begin, end, end - begin, idle, collecting)

    there, again = woken - start, back - motion.end[row]
    ticks = []
    for offset, (stage, name) in enumerate(_TICK.items()):
        at = row - len(_TICK) + 1 + offset
        answered &= motion.stages[at] == stage
        idle = np.maximum(0.0, motion.end[at] - motion.start[at] - motion.cpu[at])
        ticks.append((name, motion.start[at], motion.end[at], idle))
    # What threads waited for a core and no stage of the tick shows, they waited on the way.
    waits = motion.waited_within(start, back) + comms.waited_within(start, back) - sum(idle for *_, idle in ticks)
    beyond = [np.maximum(0.0, way - np.median(way[answered]) if answered.any() else way) for way in (there, again)]
    share = beyond[0] / np.maximum(beyond[0] + beyond[1], 1e-12)
    waits = np.maximum(0.0, waits)
    return [
        span(TO_MOTION, "", start, woken, np.minimum(waits * share, there)),
        *(span(name, MOTION, begin, end, idle) for name, begin, end, idle in ticks),
        span(TO_COMMS, "", motion.end[row], back, np.minimum(waits * (1.0 - share), again)),
    ]


def _without_answered_wait(segments: list[Segment]) -> list[Segment]:
    """Take what is told in detail out of "waits for Motor", and segments that no period has."""
    detail = [s for s in segments if s.service == MOTION or not s.service]
    told = sum((s.duration for s in detail), start=np.zeros(len(segments[0].start)))
    kept = [_shortened(s, told) if s.name == _NAMES[Stage.AWAIT_MOTOR] else s for s in segments]
    return [segment for segment in kept if segment.duration.any()]


def _shortened(wait: Segment, told: FloatArray) -> Segment:
    """The rest of a wait, at its end."""
    rest = np.maximum(0.0, wait.duration - told)
    return Segment(wait.service, wait.name, wait.end - rest, wait.end, rest, wait.without_core, wait.collecting)
