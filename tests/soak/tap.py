"""Everything that goes over the wire, heard by a node of its own, and checked as it comes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

import numpy as np

import bifrost
from tests.soak.checks import MotorChecks, StateChecks
from valor.common.behaviors import REFLEX
from valor.common.instance import Instance
from valor.common.messages import (
    ControlModeReport,
    DeviceStatus,
    GroundTruth,
    MotionState,
    Motor,
    Proprioceptor,
    Statistics,
)
from valor.common.topics import CONTROL_MODE, DEVICES, GROUND_TRUTH, MOTION_STATE, MOTOR, PROPRIOCEPTOR, STATISTICS
from valor.robot.description import RobotDescription

QUEUE = 20_000  # messages that a busy computer may leave here unread
_TURN = 0.02  # between looks [s]


@dataclass(frozen=True)
class Word:
    """What a service said of itself last, and when [monotonic, s]."""

    pid: int
    state: str
    at: float


class Tap:
    """Hears the Motion System from a thread of its own.

    Attributes:
        faults: what was not as it must be, told once a kind.
        state: newest MotionState; None: not heard yet.
        mode: newest control mode; empty: not heard yet.
        words: newest Statistics of each service.
        reflex: the Motion Manager stands aside for the Comms Manager's reflex.
        height: of the pelvis above the world's origin, in truth [m].
        changes: behaviors in order, each with its reason.
        unwell: units of devices that are not well.
        told: when the newest MotionState was published [monotonic, s].
    """

    def __init__(self, instance: Instance, robot: RobotDescription) -> None:
        self._node = bifrost.Node("soak_tap", network=bifrost.Network.load(instance.network_file, instance.keys))
        self._robot = robot
        self._lock = threading.Lock()
        self._motor_checks, self._state_checks = MotorChecks(robot), StateChecks()
        self.faults: dict[str, int] = {}
        self.state: MotionState | None = None
        self.mode = ""
        self.words: dict[str, Word] = {}
        self.reflex = False
        self.height = float("nan")
        self.changes: list[tuple[str, str]] = []
        self.heard = self.told = 0.0
        self.unwell: list[str] = []
        self._position: np.ndarray[Any, np.dtype[np.float64]] | None = None
        self._reference: np.ndarray[Any, np.dtype[np.float64]] | None = None
        self._moved = np.zeros(len(robot.joints))
        subscribe = self._node.subscriber
        self._heard: list[tuple[bifrost.Subscriber[Any], Callable[[Any], list[str] | None]]] = [
            (subscribe(MOTOR.name, Motor, queue=QUEUE), self._hear_motor),
            (subscribe(MOTION_STATE.name, MotionState, queue=QUEUE), self._hear_state),
            (subscribe(PROPRIOCEPTOR.name, Proprioceptor, queue=QUEUE), self._hear_proprioceptor),
            (subscribe(CONTROL_MODE.name, ControlModeReport, queue=QUEUE), self._hear_mode),
            (subscribe(DEVICES.name, DeviceStatus, queue=QUEUE), self._hear_devices),
            (subscribe(GROUND_TRUTH.name, GroundTruth, queue=QUEUE), self._hear_truth),
            *((subscribe(topic.name, Statistics, queue=QUEUE), self._hear_word) for topic in STATISTICS.values()),
        ]
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="tap")

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._closing.set()
        self._thread.join()
        self._node.close()

    def graph(self) -> bifrost.Graph:
        """Who is registered with bifrostd.

        Raises:
            bifrost.Error: it does not answer.
        """
        return self._node.graph(timeout=1.0)

    def mark(self) -> None:
        """Movement counts from here on."""
        with self._lock:
            self._reference = None if self._position is None else self._position.copy()
            self._moved[:] = 0.0

    def moved(self) -> tuple[str, float]:
        """The joint that was farthest from where it was at the mark, and how far [rad]; none that turns for ever."""
        with self._lock:
            farthest = int(np.argmax(np.where(np.isfinite(self._robot.upper), self._moved, 0.0)))
            return self._robot.joints[farthest], float(self._moved[farthest])

    def strayed(self, far: float) -> bool:
        """Whether a joint has moved so far since the mark, or since this was last so [rad]."""
        if self.moved()[1] > far:
            self.mark()
            return True
        return False

    def take_faults(self) -> list[str]:
        """What was found since the last call."""
        with self._lock:
            found = [f"{what} ({count} times)" for what, count in self.faults.items()]
            self.faults.clear()
        return found

    def _run(self) -> None:
        while not self._closing.wait(_TURN):
            for subscriber, hear in self._heard:
                received = subscriber.drain()
                with self._lock:
                    for each in received:
                        for fault in hear(each) or ():
                            self.faults[fault] = self.faults.get(fault, 0) + 1

    def _hear_motor(self, received: bifrost.Received[Motor]) -> list[str]:
        motor = received.message
        self.reflex = motor.behavior == REFLEX
        self._state_checks.motor(motor)
        return self._motor_checks.find(motor)

    def _hear_state(self, received: bifrost.Received[MotionState]) -> list[str]:
        state = received.message
        if self.state is None or state.behavior != self.state.behavior:
            self.changes.append((state.behavior, state.reason))
        self.state, self.heard, self.told = state, time.monotonic(), received.stamp * 1e-9
        return self._state_checks.find(state)

    def _hear_proprioceptor(self, received: bifrost.Received[Proprioceptor]) -> None:
        self._position = received.message.joint_position
        if self._reference is not None:
            np.maximum(self._moved, np.abs(self._position - self._reference), out=self._moved)

    def _hear_mode(self, received: bifrost.Received[ControlModeReport]) -> None:
        self.mode = received.message.current_control_mode

    def _hear_devices(self, received: bifrost.Received[DeviceStatus]) -> None:
        status = received.message
        self.unwell = [unit for unit, state in zip(status.units, status.states, strict=True) if state != "ok"]

    def _hear_truth(self, received: bifrost.Received[GroundTruth]) -> None:
        self.height = float(received.message.pelvis_position_in_world[2])

    def _hear_word(self, received: bifrost.Received[Statistics]) -> None:
        word = received.message
        self.words[word.service] = Word(word.pid, word.state, received.stamp * 1e-9)
