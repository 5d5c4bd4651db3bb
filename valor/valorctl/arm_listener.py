"""What an arm's sensors and commands say while it is moved, and whether it may go on."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

import numpy as np

import bifrost
from valor.calibration.record import Recorder
from valor.common.arrays import FloatArray
from valor.common.behaviors import Behavior
from valor.common.errors import ValorError
from valor.common.messages import MotionState, Motor, Proprioceptor
from valor.common.topics import MOTION_STATE, MOTOR, PROPRIOCEPTOR
from valor.robot.description import RobotDescription
from valor.valorctl.arm_motion import SIDES
from valor.valorctl.node import hear

MODES = (Behavior.STAND, Behavior.STAND_MANIPULATE)
AT_LIMIT = 0.01  # [rad]
SILENCE = 5.0  # of the Motion Manager [s]
REST = 0.5  # for which an arm that nobody leads moves no farther than … [robot time, s]
MOVED = 0.01  # … this [rad]
SETTLE = 8.0  # in which it comes to rest after a change of mode [robot time, s]
KEPT = 2000  # messages that wait for those that belong to them
HAND_GOAL = "hand_goal"


class StoppedError(ValorError):
    """The arm may not go on; it is held where it is."""


class ArmListener:
    """Hears the robot; with a recorder it keeps what it hears.

    Attributes:
        group: of robot.yaml: the arm that is watched; empty: none yet.
        recorder: of what is heard from now on; None: it is not kept.
        now: the newest Proprioceptor. state: the newest MotionState.
        tell: called whenever something was heard.
    """

    def __init__(self, node: bifrost.Node, robot: RobotDescription) -> None:
        """Of a robot, on a node in its network.

        Raises:
            ValorError: the Motion Manager or the Comms Manager is silent.
        """
        self._robot = robot
        self._groups = [f"{side}_arm" for side in SIDES]
        self.group = ""
        self._measured = PROPRIOCEPTOR.subscriber(node, queue=5000)
        self._motors = MOTOR.subscriber(node, queue=5000)
        self._states = MOTION_STATE.subscriber(node, queue=5000)
        self._proprioceptors: dict[int, Proprioceptor] = {}
        self._acting: dict[int, Motor] = {}
        self._waiting: deque[MotionState] = deque(maxlen=KEPT)
        self.recorder: Recorder | None = None
        self.tell: Callable[[], None] = lambda: None
        self.now = hear(PROPRIOCEPTOR, self._measured, SILENCE)
        self.state = hear(MOTION_STATE, self._states, SILENCE)
        self._heard = time.monotonic()

    @property
    def time(self) -> float:
        """Robot time [s]."""
        return 1e-9 * self.state.time

    @property
    def place(self) -> FloatArray:
        """(m,) where the arm is [rad]."""
        place: FloatArray = self.now.joint_position[self._robot.group_indices(self.group)]
        return place

    def require_free(self) -> None:
        """Refuse an arm that cannot be led now.

        Raises:
            ValorError: the robot does not stand, somebody has the arm, it touches something, or is at a limit.
        """
        robot, state, name = self._robot, self.state, self.group.replace("_", " ")
        if state.behavior not in MODES:
            why = f": {state.reason}" if state.reason else ""
            raise ValorError(f"calibrate {name}: the robot is in {state.behavior}{why}; expected one that stands")
        self._require_unled(state)
        for i in robot.group_indices(self.group):
            position, lower, upper = float(self.now.joint_position[i]), float(robot.lower[i]), float(robot.upper[i])
            if min(position - lower, upper - position) < AT_LIMIT:
                limit = lower if position - lower < upper - position else upper
                what = f"{robot.joints[i]} is at its limit: {position:.3f} of {limit:.3f} rad"
                raise ValorError(f"calibrate {name}: {what}; move it away (valorctl arm)")

    def require_still(self, check: Callable[[], None]) -> None:
        """Wait until the arm rests; ``check`` is called meanwhile, and may raise to give up.

        Raises:
            ValorError: somebody moves it.
        """
        self.check()
        began = since = self.time
        first = self.place
        while self.time < since + REST:
            check()
            self.check()
            if float(np.abs(self.place - first).max()) > MOVED:
                first, since = self.place, self.time
            if self.time > began + SETTLE:
                raise ValorError(f"calibrate {self.group.replace('_', ' ')}: somebody else moves it")
            time.sleep(0.02)

    def check(self) -> None:
        """Hear what has come.

        Raises:
            StoppedError: the arm may not go on.
        """
        states = [each.message for each in self._states.drain()]
        for motor in self._motors.drain():
            self._acting[motor.message.sequence] = motor.message
        for measured in self._measured.drain():
            self.now = measured.message
            self._proprioceptors[self.now.sequence] = self.now
        if states:
            self._heard = time.monotonic()
        elif time.monotonic() - self._heard > SILENCE:
            raise StoppedError(f"the Motion Manager is silent for {SILENCE:g} s")
        for state in states:
            self._watch(state)
        self._waiting.extend(states)
        self._record()
        self._acting = dict(list(self._acting.items())[-KEPT:])
        self._proprioceptors = dict(list(self._proprioceptors.items())[-KEPT:])
        self.tell()

    def _watch(self, state: MotionState) -> None:
        if state.time < self.state.time:
            raise StoppedError("robot time began anew")
        self.state = state
        if state.behavior not in MODES:
            raise StoppedError(f"the robot is in {state.behavior}: {state.reason}")
        if self.group:
            self._require_unled(state)

    def _require_unled(self, state: MotionState) -> None:
        name = self.group.replace("_", " ")
        if getattr(state, self.group) == HAND_GOAL:
            raise StoppedError(f"calibrate {name}: a hand goal of somebody else leads it")
        if state.hand_contacts[self._groups.index(self.group)]:
            raise StoppedError(f"calibrate {name}: its hand touches something, or carries something")

    def _record(self) -> None:
        """Put together what belongs together; what has not come yet is waited for."""
        if self.recorder is None:
            self._waiting.clear()
        while self.recorder is not None and self._waiting:
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
