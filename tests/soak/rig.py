"""A system under ``valorctl up``, its tap, and the hands that a soak has: those of its ordinary clients."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path

import psutil

import bifrost
from harness.system import VALORCTL, System, leftovers, shared_memory
from tests.soak import disk
from tests.soak.checks import unexpected_ends
from tests.soak.rules import Modes, way
from tests.soak.tap import Tap
from valor.common.behaviors import Behavior
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.messages import BehaviorReply, BehaviorRequest
from valor.common.topics import BEHAVIOR
from valor.robot.description import RobotDescription
from valor.valorctl.getting_up import get_up
from valor.valorctl.supervision import Supervisor

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


class BrokenError(Exception):
    """The system cannot be brought on: what was waited for."""


class Rig:
    """One system at a time, brought up anew where nothing else brings the robot to its feet.

    Attributes:
        tap: of the present system.
        killed: how often each process was killed since it came up.
        excused: processes that may end by themselves, with whatever words, until it is down.
        own_disk: what is written goes to a disk that can be filled.
        memory: samples of each process, by name and pid: time [s], memory [MiB].
        ups: how often it was brought up.
    """

    tap: Tap
    client: bifrost.Client[BehaviorRequest, BehaviorReply]

    def __init__(self, home: Path, profile: str, *options: str) -> None:
        self.home = home
        self._up = ("up", "--profile", profile, *options)
        self.system = System(NAME, home)
        self.instance = Instance(NAME, home)
        self.modes = Modes()
        self.killed: Counter[str] = Counter()
        self.excused: set[str] = set()
        self.own_disk = disk.mount(home)
        self.memory: dict[tuple[str, int], list[tuple[float, float]]] = {}
        self.ups = 0
        self._shared = shared_memory()

    # --- the system ---------------------------------------------------------------------------------------------

    def up(self) -> None:
        """Bring it up, the robot standing."""
        self.system.valorctl(*self._up, timeout=UP)
        self._attach()

    def begin_up(self) -> subprocess.Popen[str]:
        """Have it come up; ``end_up`` waits for it."""
        command = [str(VALORCTL), *self._up]
        pipe = subprocess.PIPE
        up = subprocess.Popen(command, env=self.system.environment, stdout=pipe, stderr=subprocess.STDOUT, text=True)
        self.supervisor = Supervisor(self.instance)
        return up

    def end_up(self, up: subprocess.Popen[str], killed: str) -> list[str]:
        """Wait until it is up, or has given up because of who was killed; then once more.

        Returns what was not as it must be.
        """
        said, _ = up.communicate(timeout=UP)
        found = []
        if up.returncode:
            why = [line for line in said.splitlines() if line.startswith("valorctl: ")]
            if len(why) != 1:
                found.append(f"up ended with {up.returncode}, and does not say why in one line: {said[-300:]}")
            elif "did not start" in why[0] and f"{killed} did not start: ended, terminated by SIGKILL" not in why[0]:
                found.append(f"up ended with {up.returncode}: {why[0]}")
            found += [f"left after up gave up: {each}" for each in leftovers(self.home, NAME, self._shared)]
            self.system.valorctl(*self._up, timeout=UP)
            self.killed.clear()
        before = self.killed.copy()
        self._attach()
        self.killed.update(before)
        return found

    def _attach(self) -> None:
        self.ups += 1
        self.killed.clear()
        self.robot = RobotDescription.load(self.instance.settings().robot)
        network = bifrost.Network.load(self.instance.network_file, self.instance.keys)
        self._node = bifrost.Node("soak", network=network)
        self.client = BEHAVIOR.client(self._node)
        self.tap = Tap(self.instance, self.robot)
        self.tap.__enter__()
        self.supervisor = Supervisor(self.instance)
        self.wait(lambda: self.tap.state is not None, "a MotionState")

    def down(self) -> list[str]:
        """Take it down; returns what it has left, and what ended by itself."""
        restarts = self.supervisor.restarts()
        self.tap.__exit__(None, None, None)
        self._node.close()
        self.system.valorctl("down")
        for name in self.excused:
            restarts.pop(name, None)
        return unexpected_ends(restarts, self.killed) + [
            f"left after down: {each}" for each in leftovers(self.home, NAME, self._shared)
        ]

    def pids(self) -> dict[str, int]:
        """Those that run, by name."""
        return {name: info.pid for name, info in self.supervisor.processes().items() if info.pid}

    def send(self, name: str, number: signal.Signals) -> float:
        """Send a signal to a process; returns when, monotonic [s]."""
        pid = self.pids().get(name)
        if pid is None:
            raise BrokenError(f"{name} does not run")
        if number is signal.SIGKILL:
            self.killed[name] += 1
        os.kill(pid, number)
        return time.monotonic()

    def sample(self) -> None:
        """Note how much memory each process has."""
        for name, pid in self.pids().items():
            try:
                memory = psutil.Process(pid).memory_info().rss / 2**20
            except psutil.Error:
                continue
            self.memory.setdefault((name, pid), []).append((time.monotonic(), memory))

    def unready(self, hit: Mapping[str, int], since: float) -> list[str]:
        """Processes that are not known to be ready, and units of devices that are not well.

        Args:
            hit: those of both that something happened to, which must have said so since, each with the pid that it had
                before if it was killed.
            since: monotonic [s].
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
                heard = word.at > (since if name in hit else time.monotonic() - SPOKEN)
                known = name in _BORROWED or word.pid == now
                states = ("ready",) if name in hit else ("ready", "degraded")
                well = heard and known and now != hit.get(name) and word.state in states
            if not well:
                found.append(name)
        found += [unit for unit in self.tap.unwell if unit in hit]  # others are late on a busy computer
        return found or ([] if self._daemon_answers(len(running)) else ["bifrostd"])

    def _daemon_answers(self, processes: int) -> bool:
        try:
            graph = self.tap.graph()
        except bifrost.Error:
            return False
        return len(graph.nodes) >= processes - 2  # itself, and the driver that is ROS' alone

    # --- the robot ----------------------------------------------------------------------------------------------

    @property
    def behavior(self) -> Behavior:
        """The one reported last."""
        assert self.tap.state is not None
        return Behavior(self.tap.state.behavior)

    @property
    def time(self) -> float:
        """Robot time [s]."""
        assert self.tap.state is not None
        return self.tap.state.time * 1e-9

    def wait(self, condition: Callable[[], object], what: str, patience: float = PATIENCE) -> None:
        """Wait for something.

        Raises:
            BrokenError: not in time.
        """
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
        """Have it come about, asking again while the robot is on its way or comes to rest.

        Raises:
            BrokenError: refused to the end, with the reason, or granted and not seen.
        """
        deadline = time.monotonic() + TO_STAND
        while not (reply := self.ask(behavior)).accepted:
            if time.monotonic() > deadline:
                raise BrokenError(f"{behavior} refused: {reply.reason}")
            time.sleep(0.2)
        self.wait(lambda: self.behavior is behavior, f"{behavior} after it was granted")

    def rest(self) -> None:
        """Wait until the robot has stood still for a while, its arms too.

        Raises:
            BrokenError: it does not come to rest, or has fallen.
        """

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
