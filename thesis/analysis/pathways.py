"""How long messages take along the three pathways between ROS and the robot's joints (thesis 5.2.2, figures 5.2, 5.3).

Every latency is from when a message was sent to when the next one of the pathway was, by the stamps of messages that
name one another (``pathway_stamps.py``). Beside it stands the shift of the largest cross-correlation of the joints'
positions (``pathway_lags.py``), as the thesis has all of them.

::

    Reference ──► VEC ──► MSetpoint            JointTrajectory; controller_state; JointSetpoints
                   └────────────────► Motor ──► HDT Cmd. ──► Prop. ──► JS
    Mode change cmd. ──► behavior ──► mode reported

- *VEC* stands at the moment at which the Proprioceptor was sent that its control values answer: the message that tells
  them leaves when the set-points are gone already.
- *HDT Cmd.* is the arm's ``HdtCommand``, as it left for the driver. A simulation has no driver: there it is the moment
  from which a Motor is in force, which is the Proprioceptor before the first that names it.
- The two methods do not measure the same. Stamps tell how old what a message was made of is; a lag tells how far a
  signal is behind. Set-points are extrapolated by their velocity to the moment at which they act, and joints are led
  by feed-forward: so a signal may be behind by less than its messages took, or be ahead, while a joint without feed-
  forward follows later than the first measurement that its command had any effect on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from thesis.analysis import pathway_stamps
from thesis.analysis.pathway_lags import FirstMilliradian, lags
from thesis.analysis.pathway_taps import Taps, header_time
from valor.analysis.reading.bag import Bag
from valor.analysis.reading.recording import nearest
from valor.common.arrays import FloatArray
from valor.robot.description import RobotDescription

JOINT_COMMAND = "joint command"
DRAWS = 20_000  # of a sum, for its percentiles


def interval(samples: FloatArray) -> tuple[float, float]:
    """5th and 95th percentile; NaN without samples."""
    low, high = np.quantile(samples, (0.05, 0.95)) if len(samples) else (np.nan, np.nan)
    return float(low), float(high)


@dataclass(frozen=True)
class Segment:
    """One step along a pathway: a bar of figure 5.2.

    Attributes:
        name: as in the figure.
        where: the system that takes the time.
        by_stamps: latencies [s] as differences of stamps.
        at: when each of them began, on the wall clock [s].
        by_correlation: as lags [s], one a motion and joint; empty where no signal goes through.
    """

    name: str
    where: str
    by_stamps: FloatArray
    at: FloatArray
    by_correlation: FloatArray = field(default_factory=lambda: np.empty(0))

    @property
    def mean(self) -> float:
        """[s]; NaN without samples."""
        return float(self.by_stamps.mean()) if len(self.by_stamps) else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """5th and 95th percentile [s]; NaN without samples."""
        return interval(self.by_stamps)

    @property
    def behind(self) -> float:
        """Mean lag by correlation [s]; by stamps where no signal goes through."""
        return float(self.by_correlation.mean()) if len(self.by_correlation) else self.mean

    @property
    def median(self) -> float:
        """[s], on which a few late ones do not tell; NaN without samples."""
        return float(np.median(self.by_stamps)) if len(self.by_stamps) else float("nan")


@dataclass(frozen=True)
class Pathway:
    """Segments that follow one another: a bar of figure 5.3."""

    name: str
    segments: tuple[Segment, ...]

    @property
    def mean(self) -> float:
        """Of the sum [s]."""
        return sum(segment.mean for segment in self.segments)

    @property
    def median(self) -> float:
        """The sum of the segments' medians [s]."""
        return sum(segment.median for segment in self.segments)

    @property
    def behind(self) -> float:
        """The sum of the segments' lags by correlation, the thesis' method [s]."""
        return sum(segment.behind for segment in self.segments)

    @property
    def interval(self) -> tuple[float, float]:
        """5th and 95th percentile of the sum of segments, each drawn independently of the others [s]."""
        if not all(len(segment.by_stamps) for segment in self.segments):
            return interval(np.empty(0))
        rng = np.random.default_rng(0)
        return interval(np.sum([rng.choice(segment.by_stamps, DRAWS) for segment in self.segments], axis=0))


@dataclass(frozen=True)
class Latencies:
    """All eight segments, in the order of figure 5.2, and what the Motion System did meanwhile.

    Attributes:
        segments: as in the figure.
        first: how long motions took to their first milliradian.
        driven: whether *HDT Cmd.* is a driver's.
        time: (m,) on the wall clock [s].
        behavior: (m,) of the Motion System at these times.
    """

    segments: tuple[Segment, ...]
    first: FirstMilliradian
    driven: bool
    time: FloatArray
    behavior: npt.NDArray[np.str_]

    def __getitem__(self, name: str) -> Segment:
        return next(segment for segment in self.segments if segment.name == name)

    def behaviors(self, segment: Segment) -> npt.NDArray[np.str_]:
        """The behavior in which each sample of a segment began."""
        return self.behavior[nearest(self.time, segment.at)]

    @property
    def pathways(self) -> tuple[Pathway, ...]:
        """The three sums. The set-points are a stop on the way from VEC to Motor: they do not count twice."""
        reference, _, motor, command, plant, states, commanded, reported = self.segments
        return (
            Pathway("mode change", (commanded, reported)),
            Pathway("proprioception", (states,)),
            Pathway(JOINT_COMMAND, (reference, motor, command, plant)),
        )

    @classmethod
    def together(cls, runs: Sequence[Latencies]) -> Latencies:
        """Samples of several runs, as if each had begun when the one before it ended."""
        begins = np.cumsum([0.0, *(run.time[-1] - run.time[0] for run in runs[:-1])])
        shifts = [begin - run.time[0] for begin, run in zip(begins, runs, strict=True)]
        segments = [
            Segment(
                each[0].name,
                each[0].where,
                np.concatenate([one.by_stamps for one in each]),
                np.concatenate([one.at + shift for one, shift in zip(each, shifts, strict=True)]),
                np.concatenate([one.by_correlation for one in each]),
            )
            for each in zip(*(run.segments for run in runs), strict=True)
        ]
        first = (np.concatenate([getattr(run.first, name) for run in runs]) for name in ("vec", "motor", "measured"))
        return cls(
            tuple(segments), FirstMilliradian(*first), runs[0].driven,
            np.concatenate([run.time + shift for run, shift in zip(runs, shifts, strict=True)]),
            np.concatenate([run.behavior for run in runs]),
        )  # fmt: skip

    @classmethod
    def of(cls, bag: Bag, robot: RobotDescription) -> Latencies:
        """From a bag of motions that were asked for as JointTrajectory messages, and of mode changes.

        Raises:
            BagError: the bag lacks a topic.
        """
        taps = Taps(bag, robot)
        lag, first = lags(taps)
        to_command, to_effect = pathway_stamps.to_plant(taps)
        changed, reported = pathway_stamps.mode_changes(taps)
        setpoints, states = taps.setpoints, taps.joint_states
        set_out = pathway_stamps.since_sensed(taps, setpoints, setpoints["time"])
        told = pathway_stamps.since_sensed(taps, states, header_time(states))
        return cls(
            (
                Segment("Reference → VEC", "VRC", *pathway_stamps.response(taps)),
                Segment("VEC → MSetpoint", "VRC", *set_out, lag.setpoint),
                Segment("VEC → Motor", "Motion System", *pathway_stamps.through_motion_system(taps), lag.motor),
                Segment("Motor → HDT Cmd.", "Motion System", *to_command),
                Segment("HDT Cmd. → Prop.", "robot", *to_effect, lag.plant),
                Segment("Prop. → JS", "VRC", *told, lag.state),
                Segment("Mode change cmd.", "Motion System", *changed),
                Segment("Mode change reported", "VRC", *reported),
            ),
            first,
            taps.hdt_commands is not None,
            taps.states.sent,
            taps.states.strings("behavior"),
        )
