"""A system under ``valorctl up``, its tap, and the hands that a soak has: those of its ordinary clients."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import psutil

import bifrost
from harness.system import System, leftovers, shared_memory
from tests.soak.checks import MotorChecks, unexpected_ends, way
from valor.common import messages
from valor.common import topics as common_topics
from valor.common.behaviors import REFLEX, Behavior
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.messages import BehaviorReply, BehaviorRequest, ControlModeReport, MotionState, Motor, Statistics
from valor.common.topics import BEHAVIOR, CONTROL_MODE, DEVICES, GROUND_TRUTH, MOTION_STATE, MOTOR, PROPRIOCEPTOR, Topic
from valor.robot.description import RobotDescription
from valor.valorctl.drive.getting_up import get_up
from valor.valorctl.instance.supervision import Supervisor

NAME = "soak"
PATIENCE = 60.0  # for anything to happen [s]
UP = 300.0  # for `up` [s]
TO_STAND = 40.0  # for Stand Prep to have come to rest [s]
LOW = 0.55  # the pelvis of a robot that lies or kneels; it stands at 0.8 [m]
STILL = 0.01  # a pelvis as slow as that is at rest [m/s]
STILL_JOINT = 0.02  # and a joint that goes no farther meanwhile [rad]
STILL_FOR = 1.0  # [robot time, s]
SPOKEN = 3.0  # a service that has said nothing for so long is not well [s]
_LOOK = 0.02  # [s]
_BORROWED = ("hdt_driver",)  # another process speaks for it, and so gives its own pid
QUEUE = 20_000  # messages that a busy computer may leave here unread
_TAP_TURN = 0.02  # between looks [s]


class Tap:
    """Receives the topics of the Motion System in a thread."""

    def __init__(self, instance: Instance, robot: RobotDescription) -> None:
        self._node = bifrost.Node("soak_tap", network=bifrost.Network.load(instance.network_file, instance.keys))
        self._robot = robot
        self._lock = threading.Lock()
        self._motor_checks = MotorChecks(robot)
        self.faults: dict[str, int] = {}  # with their numbers
        self.state: MotionState | None = None
        self.mode = ""  # control mode
        self.words: dict[str, bifrost.Received[Statistics]] = {}  # latest Statistics of each service
        self.reflex = False  # the balance reflex controls
        self.height = float("nan")  # of the true pelvis [m]
        self.received_at = 0.0  # when the latest MotionState was received [monotonic, s]
        self.unwell: list[str] = []  # units with faults
        self._position: np.ndarray[Any, np.dtype[np.float64]] | None = None
        self._reference: np.ndarray[Any, np.dtype[np.float64]] | None = None
        self._moved = np.zeros(len(robot.joints))
        topics: tuple[Topic[Any], ...] = (
            MOTOR, MOTION_STATE, PROPRIOCEPTOR, CONTROL_MODE, DEVICES, GROUND_TRUTH, *common_topics.STATISTICS.values()
        )  # fmt: skip
        self._subscribers = [topic.subscriber(self._node, QUEUE, limited=False) for topic in topics]
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="tap")
        self._thread.start()

    def close(self) -> None:
        self._closing.set()
        self._thread.join()
        self._node.close()

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
        """Return whether a joint has moved so far since the mark, or since this was last so [rad]."""
        if self.moved()[1] > far:
            self.mark()
            return True
        return False

    def take_faults(self) -> list[str]:
        with self._lock:
            found = [f"{what} ({count} times)" for what, count in self.faults.items()]
            self.faults.clear()
        return found

    def _run(self) -> None:
        while not self._closing.wait(_TAP_TURN):
            for subscriber in self._subscribers:
                received = subscriber.drain()
                with self._lock:
                    for each in received:
                        self._hear(each)

    def _hear(self, received: bifrost.Received[Any]) -> None:
        match message := received.message:
            case Motor():
                self.reflex = message.behavior == REFLEX
                for fault in self._motor_checks.find(message):
                    self.faults[fault] = self.faults.get(fault, 0) + 1
            case MotionState():
                self.state, self.received_at = message, time.monotonic()
            case messages.Proprioceptor():
                self._position = message.joint_position
                if self._reference is not None:
                    np.maximum(self._moved, np.abs(self._position - self._reference), out=self._moved)
            case ControlModeReport():
                self.mode = message.current_control_mode
            case messages.DeviceStatus():
                states = zip(message.units, message.states, strict=True)
                self.unwell = [unit for unit, state in states if state != "ok"]
            case messages.GroundTruth():
                self.height = float(message.pelvis_position_in_world[2])
            case Statistics():
                self.words[message.service] = received


class BrokenError(Exception):
    """The system cannot be brought on: what was waited for."""


class Rig:
    """One system at a time, started again where nothing else brings the robot to its feet."""

    tap: Tap
    client: bifrost.Client[BehaviorRequest, BehaviorReply]

    def __init__(self, home: Path, profile: str, *options: str) -> None:
        self.home = home
        self._up = ("up", "--profile", profile, *options)
        self.system = System(NAME, home)
        self.instance = Instance(NAME, home)
        self.killed: Counter[str] = Counter()  # since the system is up
        self.memory: dict[tuple[str, int], list[tuple[float, float]]] = {}  # by name and pid: time [s], memory [MiB]
        self.ups = 0
        self._shared = shared_memory()

    # --- the system ---------------------------------------------------------------------------------------------

    def up(self) -> None:
        self.system.valorctl(*self._up, timeout=UP)
        self.ups += 1
        self.killed.clear()
        self.robot = RobotDescription.load(self.instance.settings().robot)
        network = bifrost.Network.load(self.instance.network_file, self.instance.keys)
        self._node = bifrost.Node("soak", network=network)
        self.client = BEHAVIOR.client(self._node)
        self.tap = Tap(self.instance, self.robot)
        self.supervisor = Supervisor(self.instance)
        self.wait(lambda: self.tap.state is not None, "a MotionState")

    def down(self) -> list[str]:
        """Take it down; returns what it has left, and what ended by itself."""
        restarts = self.supervisor.restarts()
        self.tap.close()
        self._node.close()
        self.system.valorctl("down")
        return unexpected_ends(restarts, self.killed) + [
            f"left after down: {each}" for each in leftovers(self.home, NAME, self._shared)
        ]

    def pids(self) -> dict[str, int]:
        return {name: info.pid for name, info in self.supervisor.processes().items() if info.pid}

    def sample(self) -> None:
        """Store how much memory each process has."""
        for name, pid in self.pids().items():
            with contextlib.suppress(psutil.Error):
                sample = time.monotonic(), psutil.Process(pid).memory_info().rss / 2**20
                self.memory.setdefault((name, pid), []).append(sample)

    def send(self, name: str, number: signal.Signals) -> None:
        pid = self.pids().get(name)
        if pid is None:
            raise BrokenError(f"{name} does not run")
        if number is signal.SIGKILL:
            self.killed[name] += 1
        os.kill(pid, number)

    def unready(self, hit: Mapping[str, int], since: float) -> list[str]:
        """Processes that are not ready, and units with faults.

        Those in ``hit``, with their pids if they were killed, must have reported so since a monotonic time [s].
        """
        running = self.pids()
        found = [name for name in self.supervisor.processes() if name not in running]
        for name, now in running.items():
            word = self.tap.words.get(name)
            if name == "bifrostd":
                well = now != hit.get(name)
            elif word is None:
                well = False
            else:
                fresh = 1e-9 * word.stamp > (since if name in hit else time.monotonic() - SPOKEN)
                known = name in _BORROWED or word.message.pid == now
                states = ("ready",) if name in hit else ("ready", "degraded")
                well = fresh and known and now != hit.get(name) and word.message.state in states
            if not well:
                found.append(name)
        found += [unit for unit in self.tap.unwell if unit in hit]  # others are late on a busy computer
        return found or ([] if self._daemon_answers(len(running)) else ["bifrostd"])

    def _daemon_answers(self, processes: int) -> bool:
        try:
            graph = self._node.graph(timeout=1.0)
        except bifrost.Error:
            return False
        return len(graph.nodes) >= processes - 2  # itself, and the driver that is ROS' alone

    # --- the robot ----------------------------------------------------------------------------------------------

    @property
    def behavior(self) -> Behavior:
        assert self.tap.state is not None
        return Behavior(self.tap.state.behavior)

    @property
    def time(self) -> float:
        assert self.tap.state is not None
        return self.tap.state.time * 1e-9

    def wait(self, condition: Callable[[], object], what: str, patience: float = PATIENCE) -> None:
        deadline = time.monotonic() + patience
        while not condition():
            if time.monotonic() > deadline:
                raise BrokenError(f"not within {patience:g} s: {what}")
            time.sleep(_LOOK)

    def ask(self, behavior: Behavior) -> BehaviorReply:
        """Ask the Motion Manager for a behavior, again where it cannot be reached just now."""
        deadline = time.monotonic() + PATIENCE
        while True:
            try:
                return self.client.call(BehaviorRequest(behavior), timeout=5.0)
            except bifrost.Error as error:
                if time.monotonic() > deadline:
                    raise BrokenError(f"motion_manager answers no request: {error}") from None
                time.sleep(0.1)

    def go(self, behavior: Behavior) -> None:
        deadline = time.monotonic() + TO_STAND
        while not (reply := self.ask(behavior)).accepted:
            if time.monotonic() > deadline:
                raise BrokenError(f"{behavior} refused: {reply.reason}")
            time.sleep(0.2)
        self.wait(lambda: self.behavior is behavior, f"{behavior} after it was granted")

    def rest(self) -> None:
        """Wait until the robot has stood still for a while, its arms too."""
        moved = self.time
        self.tap.mark()

        def still() -> bool:
            nonlocal moved
            state = self.tap.state
            assert state is not None
            if self.behavior is Behavior.FALL:
                raise BrokenError(f"fall: {state.reason}")
            sways = abs(state.pelvis_linear_velocity_in_odom).max() > STILL or not state.contacts.all()
            if sways or self.tap.strayed(STILL_JOINT):
                moved = self.time
            return not 0.0 <= self.time - moved < STILL_FOR

        self.wait(still, "the robot at rest")

    def stand(self) -> bool:
        """Bring the robot to Stand by commands; returns whether that needed another ``up``."""
        try:
            if self.tap.height < LOW:
                self._from_the_floor()
            for behavior in way(self.behavior, Behavior.STAND):
                self.go(behavior)
            self.rest()
        except (BrokenError, ValorError) as trouble:
            if self.behavior is not Behavior.FALL and self.tap.height > LOW:
                raise
            print(f"      on the floor ({trouble}): down and up")
            return True
        return False

    def _from_the_floor(self) -> None:
        if self.behavior is not Behavior.FALL:
            self.go(Behavior.FALL)
        at = time.monotonic()
        self.wait(lambda: time.monotonic() - at > 3.0, "the robot at rest")
        get_up(self.instance, lambda: None, lambda _: None)
