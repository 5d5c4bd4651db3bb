"""Calibration of arms of a standing robot: motion through poses and back, then identification."""

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

import bifrost
from valor.calibration.identify import Found, identify
from valor.calibration.poses import Poses
from valor.calibration.record import Record, Recorder
from valor.common.arrays import FloatArray
from valor.common.behaviors import Behavior, ControlMode
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.messages import MotionState, Motor, Proprioceptor
from valor.common.topics import MOTION_STATE, MOTOR, PROPRIOCEPTOR
from valor.robot.description import RobotDescription
from valor.robot.model import full_model
from valor.valorctl.drive import control_mode
from valor.valorctl.drive.arm_motion import SIDES, follow, trajectory_duration
from valor.valorctl.drive.node import join, next_message
from valor.valorctl.drive.ros_client import RosClient
from valor.valorctl.terminal.console import InterruptedBySignalError, Interruption

MODES = (Behavior.STAND, Behavior.STAND_MANIPULATE)
AT_LIMIT = 0.01  # [rad]
SILENCE = 5.0  # timeout of MotionState [s]
REST = 0.5  # duration of rest of an arm [robot time, s]
MOVED = 0.01  # motion of an arm at rest, at most [rad]
SETTLE = 8.0  # time to come to rest after a change of mode [robot time, s]
KEPT = 2000  # messages stored until the matching ones are received
HAND_GOAL = "hand_goal"


class StoppedError(ValorError):
    """The motion has to stop; the arm holds its position."""


class ArmListener:
    """Receives the robot's state; with a recorder, also stores it."""

    def __init__(self, node: bifrost.Node, robot: RobotDescription) -> None:
        """Subscribe; raises ``ValorError`` if Motion Manager or Comms Manager does not publish."""
        self._robot = robot
        self.group = ""  # of robot.yaml, the arm to monitor; empty: none yet
        self._measured = PROPRIOCEPTOR.subscriber(node, queue=5000)
        self._motors = MOTOR.subscriber(node, queue=5000)
        self._states = MOTION_STATE.subscriber(node, queue=5000)
        self._proprioceptors: dict[int, Proprioceptor] = {}
        self._acting: dict[int, Motor] = {}
        self._waiting: deque[MotionState] = deque(maxlen=KEPT)
        self.recorder: Recorder | None = None
        self.tell: Callable[[], None] = lambda: None  # called after each ``check``
        self.now = next_message(PROPRIOCEPTOR, self._measured, SILENCE)
        self.state = next_message(MOTION_STATE, self._states, SILENCE)
        self._received = time.monotonic()

    @property
    def name(self) -> str:
        """Name of the arm for the user."""
        return self.group.replace("_", " ")

    @property
    def time(self) -> float:
        """Robot time [s]."""
        return 1e-9 * self.state.time

    @property
    def position(self) -> FloatArray:
        """(m,) position of the arm [rad]."""
        position: FloatArray = self.now.joint_position[self._robot.group_indices(self.group)]
        return position

    def require_free(self) -> None:
        """Raise ``ValorError`` if the robot does not stand, or the arm is in use, in contact or at a limit."""
        state, robot = self.state, self._robot
        if state.behavior not in MODES:
            why = f": {state.reason}" if state.reason else ""
            raise ValorError(
                f"calibrate {self.name}: the robot is in {state.behavior}{why}; expected stand or stand_manipulate"
            )
        self._require_uncontrolled(state)
        for i, position in zip(robot.group_indices(self.group), self.position, strict=True):
            limit = min(float(robot.lower[i]), float(robot.upper[i]), key=lambda each: abs(each - position))
            if not robot.lower[i] + AT_LIMIT <= position <= robot.upper[i] - AT_LIMIT:
                what = f"{robot.joints[i]} is at its limit: {position:.3f} of {limit:.3f} rad"
                raise ValorError(f"calibrate {self.name}: {what}; move it away (valorctl arm)")

    def require_still(self, check: Callable[[], None]) -> None:
        """Wait until the arm rests, calling ``check``; raises ``ValorError`` if another client moves it."""
        self.check()
        began = since = self.time
        first = self.position
        while self.time < since + REST:
            check()
            self.check()
            if float(np.abs(self.position - first).max()) > MOVED:
                first, since = self.position, self.time
            if self.time > began + SETTLE:
                raise ValorError(f"calibrate {self.name}: another client moves it")
            time.sleep(0.02)

    def check(self) -> None:
        """Process the received messages; raises ``StoppedError`` if the motion has to stop."""
        states = [each.message for each in self._states.drain()]
        for motor in self._motors.drain():
            self._acting[motor.message.sequence] = motor.message
        for measured in self._measured.drain():
            self.now = measured.message
            self._proprioceptors[self.now.sequence] = self.now
        if states:
            self._received = time.monotonic()
        elif time.monotonic() - self._received > SILENCE:
            raise StoppedError(f"no MotionState for {SILENCE:g} s; see `valorctl status`")
        for state in states:
            self._watch(state)
        self._waiting.extend(states)
        self._record()
        self._acting = dict(list(self._acting.items())[-KEPT:])
        self._proprioceptors = dict(list(self._proprioceptors.items())[-KEPT:])
        self.tell()

    def _watch(self, state: MotionState) -> None:
        if state.time < self.state.time:
            raise StoppedError("robot time restarted")
        self.state = state
        if state.behavior not in MODES:
            raise StoppedError(f"the robot is in {state.behavior}: {state.reason}")
        if self.group:
            self._require_uncontrolled(state)

    def _require_uncontrolled(self, state: MotionState) -> None:
        if getattr(state, self.group) == HAND_GOAL:
            raise StoppedError(f"calibrate {self.name}: a hand goal of another client controls it")
        if state.hand_contacts[[f"{side}_arm" for side in SIDES].index(self.group)]:
            raise StoppedError(f"calibrate {self.name}: its hand touches or carries something")

    def _record(self) -> None:
        """Match states with measurements and commands; unmatched ones wait."""
        if self.recorder is None:
            self._waiting.clear()
            return
        while self._waiting:
            state = self._waiting[0]
            measured = self._proprioceptors.get(state.proprioceptor_sequence)
            if measured is None and state.proprioceptor_sequence > self.now.sequence:
                return
            self._waiting.popleft()
            acting = self._acting.get(measured.motor_sequence) if measured is not None else None
            if measured is None or acting is None:  # lost
                self.recorder.interrupt()
            else:
                self.recorder.add(measured, acting, state.pelvis_orientation_in_odom)


PAUSE = 0.3  # in a pose [robot time, s]
MODE = ControlMode.STAND_MANIPULATE
POLL = 0.02  # [s]

Bar = Callable[[float], AbstractContextManager[Callable[[float], None]]]


@dataclass(frozen=True)
class _Way:
    """Motion of an arm through poses (m,) [rad], with their durations [robot time, s]."""

    group: str
    poses: Poses
    goals: list[FloatArray]
    durations: list[float]

    @property
    def duration(self) -> float:
        """Total duration [s]."""
        return sum(self.durations) + PAUSE * len(self.goals)


class ArmCalibrating:
    """Calibration of the arms of an instance's robot, one after the other; used once."""

    _listener: ArmListener
    _ros: RosClient

    def __init__(
        self, instance: Instance, robot: RobotDescription, interruption: Interruption, *, poses: int, speed: float
    ) -> None:
        """``poses``: of each arm; ``speed``: share of the joints' speed limits."""
        self._instance, self._robot, self._interruption = instance, robot, interruption
        self._poses, self._speed = poses, speed

    def run(self, groups: Sequence[str], stage: Callable[[str], None], bar: Bar) -> dict[str, Found]:
        """Move arms, and identify their parameters; ``bar`` shows progress, of a total [robot time, s].

        Raises ``ValorError``: an arm cannot be controlled, or had to stop; it then holds its position.
        ``InterruptedBySignalError``: by the user; the arm is back at its start.
        """
        records: dict[str, Record] = {}
        with join(self._instance) as node:
            stage("choosing poses")
            self._listener = ArmListener(node, self._robot)
            ways = [self._plan(group) for group in groups]
            with (
                self._manipulating(),
                RosClient(self._instance, self._check) as self._ros,
                bar(sum(way.duration for way in ways)) as shown,
            ):
                before = 0.0
                for way in ways:
                    records[way.group] = self._measure(way, before, shown)
                    before += way.duration
        stage("identifying")
        model = full_model(self._robot)
        found = {}
        for group, record in records.items():
            found[group] = identify(model, group, record, self._poses)
            self._interruption.check()
        return found

    def _check(self) -> None:
        self._interruption.check()
        self._listener.check()

    def _plan(self, group: str) -> _Way:
        """Choose an arm's poses; raises ``ValorError`` if it cannot be controlled now, or no pose is reachable."""
        listener = self._listener
        listener.group = group
        listener.require_free()
        listener.require_still(self._interruption.check)
        chooser = Poses(full_model(self._robot, "collision"), group, listener.now.joint_position)
        goals = [listener.position]
        for _ in range(self._poses):
            self._check()
            goals.append(chooser.next())
        durations = [self._duration(group, *ends) for ends in pairwise(goals)]
        return _Way(group, chooser, goals[1:], durations)

    @contextmanager
    def _manipulating(self) -> Iterator[None]:
        """Enter the mode for arms, and the previous one at the end, unless an error ended it."""
        before = control_mode.report(self._instance).current_control_mode
        if before == MODE:
            yield
            return
        control_mode.enter(self._instance, MODE, self._interruption.check)
        try:
            yield
        except InterruptedBySignalError:
            control_mode.enter(self._instance, before)
            raise
        control_mode.enter(self._instance, before, self._interruption.check)

    def _measure(self, way: _Way, before: float, shown: Callable[[float], None]) -> Record:
        """Move an arm through its poses and back; ``shown`` receives the progress, ``before`` at the start [s]."""
        listener = self._listener
        listener.group = way.group
        listener.require_still(self._interruption.check)
        if not way.poses.clear(listener.now.joint_position, way.goals[0]):
            raise ValorError(f"calibrate {listener.name}: moved by another client, and no path from there is free")
        recorder = listener.recorder = Recorder(self._robot)
        start, reached = listener.time, 0
        listener.tell = lambda: shown(before + min(listener.time - start, way.duration))
        try:
            for goal, duration in zip(way.goals, way.durations, strict=True):
                self._go(way.group, goal, duration)
                reached += 1
                until = listener.time + PAUSE
                while listener.time < until:
                    self._check()
                    time.sleep(POLL)
        except InterruptedBySignalError:
            with Interruption() as self._interruption:  # a second signal stops the arm where it is
                self._go_back(way, reached)
            raise
        except ValorError as error:
            raise ValorError(f"{error}; the arm holds its position") from None
        self._go_back(way, reached)
        listener.recorder = None
        return recorder.record()

    def _go_back(self, way: _Way, reached: int) -> None:
        for goal in way.poses.back(self._listener.position, reached):
            self._go(way.group, goal, self._duration(way.group, self._listener.position, goal))

    def _go(self, group: str, goal: FloatArray, duration: float) -> None:
        follow(self._ros, group, self._by_joint(group, goal), duration, tolerant=True)

    def _duration(self, group: str, start: FloatArray, goal: FloatArray) -> float:
        return trajectory_duration(self._robot, self._by_joint(group, start), self._by_joint(group, goal), self._speed)

    def _by_joint(self, group: str, position: FloatArray) -> dict[str, float]:
        return dict(zip(self._robot.tables.group(group), position.tolist(), strict=True))
