"""How long messages take along the three pathways between ROS and the robot's joints (thesis 5.2.2, figures 5.2, 5.3).

Every latency is from when a message was sent to when the next one of the pathway was. Where both stamps are known
to belong together it is their difference; where a signal changes its form on the way it is the shift of the largest
cross-correlation (``lag.py``), as the thesis has all of them; where both can be had, both are given.

::

    Reference ──► VEC ──► MSetpoint            JointTrajectory; controller_state; JointSetpoints
                   └────────────────► Motor ──► HDT Cmd. ──► Prop. ──► JS
    Mode change cmd. ──► behavior ──► mode reported

- *VEC* stands at the moment at which the Proprioceptor was sent that its control values answer: the message that tells
  them leaves when the set-points are gone already.
- *HDT Cmd.* is the Motor that the devices obey, by Proprioceptor's ``motor_sequence``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from valor.analysis.bag import Bag, Series
from valor.analysis.errors import SignalError
from valor.analysis.lag import lag
from valor.analysis.recording import Recording, nearest, recorded
from valor.analysis.signals import Signal
from valor.bags.errors import BagError
from valor.common.arrays import FloatArray
from valor.common.topics import JOINT_SETPOINTS, MOTION_STATE, MOTOR, PROPRIOCEPTOR
from valor.robot.description import RobotDescription

CONTROLLER = "/trajectory_controllers/right_arm_traj_controller"
REFERENCE, VEC = f"{CONTROLLER}/joint_trajectory", f"{CONTROLLER}/controller_state"
MODE_COMMAND, MODE_REPORT = "/flor/controller/mode_command", "/flor/controller/mode"
JOINT_STATES = "/joint_states"

LONGEST = 0.25  # delay that is looked for [s]
BEFORE, AFTER = 0.15, 0.45  # a motion, that its signals are looked at [s]
MOVED = 0.05  # a joint that goes less far says nothing of delays [rad]
RESPONDS = 1e-6  # a control value that is faster moves [rad/s]
ANSWER = 5.0  # in which a mode change must be seen [s]

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Segment:
    """One step along a pathway: a bar of figure 5.2.

    Attributes:
        name: as in the figure.
        where: the system that takes the time.
        by_stamps: latencies [s] as differences of stamps; empty where none belong together.
        by_correlation: latencies [s] as lags, one a motion and joint; empty where no signal goes through.
        at: when each of ``samples`` began, on the wall clock [s].
    """

    name: str
    where: str
    by_stamps: FloatArray = field(default_factory=lambda: np.empty(0))
    by_correlation: FloatArray = field(default_factory=lambda: np.empty(0))
    at: FloatArray = field(default_factory=lambda: np.empty(0))

    @property
    def samples(self) -> FloatArray:
        """Those that the figures show: by stamps where there are any."""
        return self.by_stamps if len(self.by_stamps) else self.by_correlation

    @property
    def mean(self) -> float:
        """[s]; NaN without samples."""
        return float(self.samples.mean()) if len(self.samples) else float("nan")

    @property
    def deviation(self) -> float:
        """Standard deviation [s]; NaN without samples."""
        return float(self.samples.std()) if len(self.samples) else float("nan")

    @property
    def median(self) -> float:
        """[s], on which a few late ones do not tell; NaN without samples."""
        return float(np.median(self.samples)) if len(self.samples) else float("nan")


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
    def deviation(self) -> float:
        """Of the sum of independent segments [s]."""
        return float(np.sqrt(sum(segment.deviation**2 for segment in self.segments)))


@dataclass(frozen=True)
class Latencies:
    """All eight segments, in the order of figure 5.2, and what the Motion System did meanwhile.

    Attributes:
        segments: as in the figure.
        time: (m,) on the wall clock [s].
        behavior: (m,) of the Motion System at these times.
    """

    segments: tuple[Segment, ...]
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
            Pathway("joint command", (reference, motor, command, plant)),
        )

    @classmethod
    def of(cls, bag: Bag, robot: RobotDescription) -> Latencies:
        """From a bag of motions that were asked for as JointTrajectory messages, and of mode changes.

        Raises:
            BagError: the bag lacks a topic.
        """
        return _Signals(bag, robot).latencies()


class _Signals:
    """What a bag has of the pathways, on the wall clock's axis [s]."""

    def __init__(self, bag: Bag, robot: RobotDescription) -> None:
        recording = Recording(bag, robot)
        told = (recorded(topic) for topic in (PROPRIOCEPTOR, MOTOR, MOTION_STATE, JOINT_SETPOINTS))
        bag.load(*told, REFERENCE, VEC, JOINT_STATES, MODE_COMMAND, MODE_REPORT)
        self._robot, self._bag = robot, bag
        self._senses, self._motor = recording.series(PROPRIOCEPTOR), recording.series(MOTOR)
        self._setpoints, self._states = recording.series(JOINT_SETPOINTS), recording.series(MOTION_STATE)
        self._references, self._vec, self._joint_states = bag[REFERENCE], bag[VEC], bag[JOINT_STATES]
        self._measured = recording.joints(PROPRIOCEPTOR, "joint_position")
        self._commanded = recording.joints(MOTOR, "position")
        self._vec_rows, self._vec_time = self._when_sensed(_header(self._vec))
        if not len(self._vec_rows):
            raise BagError(f"{bag.path}: {VEC} and Proprioceptor have no robot time in common")

    def latencies(self) -> Latencies:
        """All of them."""
        (setpoint, motor, plant, state), motions = self._by_correlation()
        changed, reported, asked, seen = self._mode_changes()
        setpoint_stamps, setpoint_at = self._since_sensed(self._setpoints, self._setpoints["time"])
        state_stamps, state_at = self._since_sensed(self._joint_states, _header(self._joint_states))
        response, referred = self._response()
        obeyed, told = self._obeyed()
        return Latencies(
            (
                Segment("Reference → VEC", "VRC", by_stamps=response, at=referred),
                Segment("VEC → MSetpoint", "VRC", setpoint_stamps, setpoint, setpoint_at),
                Segment("VEC → Motor", "Motion System", by_correlation=motor, at=motions[1]),
                Segment("Motor → HDT Cmd.", "Motion System", by_stamps=obeyed, at=told),
                Segment("HDT Cmd. → Prop.", "robot", by_correlation=plant, at=motions[2]),
                Segment("Prop. → JS", "VRC", state_stamps, state, state_at),
                Segment("Mode change cmd.", "Motion System", by_stamps=changed, at=asked),
                Segment("Mode change reported", "VRC", by_stamps=reported, at=seen),
            ),
            self._states.sent,
            self._states.strings("behavior"),
        )

    def _when_sensed(self, robot_time: FloatArray) -> tuple[Indices, FloatArray]:
        """Of messages that name a robot time [ns]: which have a Proprioceptor, and when that was sent [s]."""
        known = self._senses["time"]
        place = np.clip(np.searchsorted(known, robot_time), 0, len(known) - 1)
        rows = np.flatnonzero(known[place] == robot_time)
        return rows, self._senses.sent[place[rows]]

    def _since_sensed(self, series: Series, robot_time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """From a Proprioceptor sent to the message that was made of it sent, and when the first was [s]."""
        rows, sensed = self._when_sensed(robot_time)
        return series.sent[rows] - sensed, sensed

    def _motions(self) -> Iterator[tuple[float, float, Sequence[str]]]:
        """When a motion was asked for, when it ended, as robot time goes [s], and its joints."""
        robot_time, sent = self._senses.time, self._senses.sent
        for asked, message in zip(self._references.sent.tolist(), self._references.messages, strict=True):
            last = message.points[-1].time_from_start
            end = np.interp(asked, sent, robot_time) + last.sec + 1e-9 * last.nanosec
            yield asked, float(np.interp(end, robot_time, sent)), message.joint_names

    def _response(self) -> tuple[FloatArray, FloatArray]:
        """From a reference sent to control values that move, and when the reference was sent [s]."""
        speed = np.abs(self._vec["reference.velocities"][self._vec_rows]).max(axis=1)
        found, asked = [], []
        for sent, end, _ in self._motions():
            during = (self._vec_time > sent) & (self._vec_time < end)
            moving = np.flatnonzero(during & (speed > RESPONDS))
            before = np.flatnonzero(self._vec_time <= sent)
            if moving.size and before.size and speed[before[-1]] <= RESPONDS:
                found.append(self._vec_time[moving[0]] - sent)
                asked.append(sent)
        return np.array(found), np.array(asked)

    def _obeyed(self) -> tuple[FloatArray, FloatArray]:
        """From a Motor sent to the first Proprioceptor that says that it is obeyed, and when the first was [s]."""
        obeyed = self._senses["motor_sequence"]
        place = np.searchsorted(obeyed, self._motor["sequence"])
        known = place < len(obeyed)
        known[known] &= obeyed[place[known]] == self._motor["sequence"][known]
        told = self._motor.sent[known]
        return self._senses.sent[place[known]] - told, told

    def _by_correlation(self) -> tuple[list[FloatArray], list[FloatArray]]:
        """Lags: VEC to set-points, VEC to Motor, Motor in force to measured, measured to joint states; and when [s]."""
        positions = self._vec["reference.positions"][self._vec_rows]
        names = list(self._vec.messages[0].joint_names)
        setpoints = self._setpoints.by_joint("position", self._setpoints.sent)
        told = self._joint_states.by_joint("position", self._joint_states.sent)
        obeyed = np.searchsorted(self._motor["sequence"], self._senses["motor_sequence"])
        in_force = self._commanded[obeyed.clip(max=len(self._motor) - 1)]
        found: tuple[list[tuple[float, float]], ...] = ([], [], [], [])
        for sent, end, joints in self._motions():
            for joint in set(joints) & set(names) & setpoints.keys():
                column = self._robot.index[joint]
                vec, setpoint, motor, command, measured, state = (
                    _part(time, value, sent - BEFORE, end + AFTER)
                    for time, value in (
                        (self._vec_time, positions[:, names.index(joint)]),
                        setpoints[joint],
                        (self._motor.sent, self._commanded[:, column]),
                        (self._senses.sent, in_force[:, column]),
                        (self._senses.sent, self._measured[:, column]),
                        told[joint],
                    )
                )
                if vec is None or np.ptp(vec.value) < MOVED:
                    continue
                pairs = ((vec, setpoint), (vec, motor), (command, measured), (measured, state))
                for each, (earlier, later) in zip(found, pairs, strict=True):
                    each.extend((delay, sent) for delay in _lag(earlier, later))
        columns = [np.array(each).reshape(-1, 2).T for each in found]
        return [lags for lags, _ in columns], [at for _, at in columns]

    def _mode_changes(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """From a command sent to the behavior changed, from that to the report sent; when each began [s]."""
        commands, reports = self._bag[MODE_COMMAND], self._bag[MODE_REPORT]
        behavior, at = self._states.strings("behavior"), self._states.sent
        changed_at = at[1:][behavior[1:] != behavior[:-1]]
        told_mode = reports.strings("current_control_mode")
        to_change, to_report, asked, seen = [], [], [], []
        for sent, message in zip(commands.sent, commands.messages, strict=True):
            changes = changed_at[(changed_at > sent) & (changed_at < sent + ANSWER)]
            if not changes.size:
                continue
            told = (reports.sent > changes[0]) & (told_mode == message.requested_control_mode)
            if told.any():
                to_change.append(changes[0] - sent)
                to_report.append(reports.sent[told][0] - changes[0])
                asked.append(sent)
                seen.append(changes[0])
        return np.array(to_change), np.array(to_report), np.array(asked), np.array(seen)


def _header(series: Series) -> FloatArray:
    """(n,) robot time of messages by their headers [ns]."""
    made: FloatArray = 1e9 * series["header.stamp.sec"] + series["header.stamp.nanosec"]
    return made


def _part(time: FloatArray, value: FloatArray, first: float, last: float) -> Signal | None:
    """The part of a signal between two moments [s]; None: there is too little of it."""
    try:
        return Signal.of(time, value).between(first, last)
    except SignalError:
        return None


def _lag(earlier: Signal | None, later: Signal | None) -> list[float]:
    """How much later the second one is [s], alone; nothing where it cannot be told."""
    if earlier is None or later is None:
        return []
    try:
        return [lag(earlier, later, LONGEST).seconds]
    except SignalError:
        return []
