"""Stopping the robot by every path at once, whatever of the system still runs.

Over Bifrost the Motion Manager is asked, and the Comms Manager, which obeys when no Motion Manager does; over ROS the
Valor ROS Controller, in a process of its own, for rclpy takes half a second to import. What counts is nobody's answer
but the Comms Manager's word on what the motors do.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec

import bifrost
from valor.common.behaviors import EMERGENCY_STOP, REFLEX, Behavior, ControlMode
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.messages import BehaviorReply, BehaviorRequest
from valor.common.topics import BEHAVIOR, PROPRIOCEPTOR, STOP, ServiceTopic
from valor.valorctl.console import say, say_json
from valor.valorctl.interruption import Interruption
from valor.valorctl.plain_command import plain_command

LONGEST = 3.0  # until it is given up, once somebody has answered [s]
LONGEST_WITHOUT_ANSWER = 10.0  # on a busy computer rclpy takes long to import [s]
LONGEST_TO_FREEZE = 15.0  # a robot that walks is frozen once it stands [s]
LASTING = 0.1  # for which the motors must obey before it is believed: a change of mode may be under way [s]
_ANSWER = 1.0  # until a request is made anew [s]
_PAUSE = 0.05  # between rounds of requests [s]
_LOOK = 0.01  # [s]


@dataclass(frozen=True)
class Goal:
    """Where the robot shall come to rest.

    Attributes:
        reached: what is meant: behaviors, or the balance reflex, which keeps the balance and holds the joints then.
        requests: what the Motion Manager is asked for, each when it has refused the one before; the Comms Manager is
            asked for the first.
        modes: what the VRC is asked for, likewise.
        longest: how long to try [s].
    """

    reached: tuple[str, ...]
    requests: tuple[str, ...]
    modes: tuple[str, ...]
    longest: float


_B = Behavior

HALT = Goal((_B.SOFT_STOP, _B.FREEZE, _B.FALL, REFLEX), (_B.SOFT_STOP, _B.FREEZE, _B.FALL), (EMERGENCY_STOP,), LONGEST)
"""Keep the balance where there is one, else lock the joints; on its way up from the floor only Fall follows."""

LOCK = Goal((_B.FREEZE,), (_B.FREEZE, _B.SOFT_STOP, _B.FALL), (ControlMode.FREEZE, EMERGENCY_STOP), LONGEST_TO_FREEZE)
"""Lock the joints: a robot that walks or steps must come to stand before."""


@dataclass
class Path:
    """One way to the robot.

    Attributes:
        name: whom it leads to, over what.
        answer: what was answered; empty: nothing yet.
        after: when, since the stop was asked for [s]; None: not at all.
    """

    name: str
    answer: str = ""
    after: float | None = None


@dataclass
class Stop:
    """What became of it.

    Attributes:
        state: what the robot is confirmed to be in; empty: it is not confirmed to have stopped.
        after: when that was, since it was asked for [s].
        seen: what is known of the robot otherwise.
        paths: that were tried.
    """

    state: str = ""
    after: float = 0.0
    seen: str = ""
    paths: list[Path] = field(default_factory=list)

    def as_json(self) -> dict[str, Any]:
        """The object of ``stop --json``."""
        return {
            "stopped": bool(self.state),
            "state": self.state or None,
            "after_s": self.after if self.state else None,
            "seen": self.seen or None,
            "paths": [{"name": p.name, "answer": p.answer or None, "after_s": p.after} for p in self.paths],
        }

    def lines(self) -> list[str]:
        """A line a path."""
        return [
            f"  {path.name}: {path.answer or 'no answer'}" + (f" ({path.after * 1e3:.0f} ms)" if path.after else "")
            for path in self.paths
        ]


def command_line(arguments: Sequence[str]) -> tuple[Instance, Goal, bool] | None:
    """What a command line that is nothing but ``stop`` asks for, and whether as JSON; None: another one."""
    if plain := plain_command(arguments, "stop", ("--freeze", "--json")):
        instance, options = plain
        return instance, LOCK if "--freeze" in options else HALT, "--json" in options
    return None


def run(instance: Instance, goal: Goal, json: bool) -> None:
    """The verb: stop the robot, and say what became of it.

    Raises:
        ValorError: it is not confirmed to have stopped, or the instance is not up.
    """
    with Interruption() as interruption:
        stopped = stop(instance, goal, interruption.check)
    if json:
        say_json(stopped.as_json())
    elif stopped.state:
        say("\n".join([f"stopped after {stopped.after:.2f} s: {stopped.state}", *stopped.lines()]))
    if not stopped.state:
        raise ValorError("\n".join([f"not confirmed to have stopped: {stopped.seen}", *stopped.lines()]))


def stop(instance: Instance, goal: Goal, check: Callable[[], None] = lambda: None) -> Stop:
    """Stop the robot. The supervisor is not needed, nor more than one of the paths.

    Args:
        instance: must be up.
        goal: ``HALT`` or ``LOCK``.
        check: called while waiting; may raise to give up. What was asked for stays asked for.

    Raises:
        ConfigurationError: the instance is not up, or its network is not readable.
    """
    began = time.monotonic()
    instance.settings()
    with _MotionSystem(instance, goal, began) as system:
        system.advance()
        ros = _Ros(instance, goal, began)
        try:
            while not (state := system.confirmed()):
                if time.monotonic() - began > _patience(goal, system, ros.path):
                    break
                check()
                system.wait()
                system.advance()
                if system.obeys:
                    ros.close("not needed")  # it would ask the same Motion Manager for the same
                ros.advance()
        finally:
            ros.close("not needed" if system.confirmed() else "")
        return Stop(state, time.monotonic() - began, system.seen(), [*system.paths, ros.path])


def _patience(goal: Goal, system: _MotionSystem, ros_path: Path) -> float:
    """How long to go on trying [s]."""
    if any(path.after is not None for path in system.paths):
        return goal.longest
    return LONGEST if ros_path.answer else LONGEST_WITHOUT_ANSWER


class _Asked:
    """One process, asked over Bifrost, again and again until it obeys.

    Attributes:
        path: what it has answered.
        client: whose answer is waited for.
        obeys: by its own word.
    """

    def __init__(
        self,
        node: bifrost.Node,
        service: ServiceTopic[BehaviorRequest, BehaviorReply],
        requests: Sequence[str],
        goal: Goal,
        began: float,
    ) -> None:
        """``requests``: what it is asked for, each when it has refused the one before."""
        self.path = Path(f"{service.owner}, over Bifrost")
        self.client = service.client(node)
        self.obeys = False
        self._requests, self._goal, self._began = requests, goal, began
        self._request = -1  # the one that is open; -1: none
        self._next = 0.0  # when the next round begins, monotonic [s]

    def advance(self) -> None:
        """Ask, and take in what was answered."""
        now = time.monotonic()
        if self._request < 0:
            if now >= self._next and not self.obeys:
                self._ask(0)
            return
        try:
            reply = self.client.answer()
        except bifrost.NoServerError:
            self._round_ends(now)
            return
        except bifrost.Error as error:
            self.path.answer = self.path.answer or str(error)
            self._round_ends(now)
            return
        if reply is not None:
            self._take(reply, now)

    def doubt(self, undone: bool, now: float) -> None:
        """The motors do not do what it said; when they have ceased to, or after a while, it is asked anew."""
        self.obeys &= not undone and now < self._next + _ANSWER

    def _ask(self, request: int) -> None:
        self._request = request
        self.client.ask(BehaviorRequest(self._requests[request]), timeout=_ANSWER)

    def _take(self, reply: BehaviorReply, now: float) -> None:
        asked, others = self._requests[self._request], self._requests[self._request + 1 :]
        self.obeys = reply.behavior in self._goal.reached
        if self.obeys or reply.accepted or self.path.after is None:
            self.path.answer = reply.behavior if self.obeys or reply.accepted else f"{asked} refused: {reply.reason}"
            self.path.after = now - self._began
        # To let the robot go is for one that is on its way up, and for nobody who refuses for another reason.
        if self.obeys or reply.accepted or not others or (others[0] == _B.FALL and reply.behavior != _B.GET_UP):
            self._round_ends(now)
        else:
            self._ask(self._request + 1)

    def _round_ends(self, now: float) -> None:
        self._request = -1
        self._next = now + _PAUSE


class _MotionSystem:
    """Motion Manager and Comms Manager, asked over Bifrost, and what the latter says of the motors."""

    def __init__(self, instance: Instance, goal: Goal, began: float) -> None:
        self._goal = goal
        network = bifrost.Network.load(instance.network_file, instance.keys)
        self._node = bifrost.Node("valorctl", network=network, recall=True)
        self._states = PROPRIOCEPTOR.subscriber(self._node)
        self._asked = [
            _Asked(self._node, BEHAVIOR, goal.requests, goal, began),
            _Asked(self._node, STOP, goal.requests[:1], goal, began),
        ]
        self._behavior = ""  # of the newest Motor
        self._since: float | None = None  # when the motors began to obey, monotonic [s]
        self._heard = 0.0  # when they were heard of last, monotonic [s]

    def __enter__(self) -> _MotionSystem:
        return self

    def __exit__(self, *exception: object) -> None:
        self._node.close()

    @property
    def paths(self) -> list[Path]:
        """Both."""
        return [asked.path for asked in self._asked]

    @property
    def obeys(self) -> bool:
        """Whether one of them does, by its own word."""
        return any(asked.obeys for asked in self._asked)

    def wait(self) -> None:
        sources: tuple[Any, ...] = (*(asked.client for asked in self._asked), self._states)
        bifrost.wait(sources, timeout=_LOOK)

    def advance(self) -> None:
        """Ask, and take in what has come."""
        self._look()
        for asked in self._asked:
            asked.advance()

    def _look(self) -> None:
        received = self._states.latest()
        if received is None:
            return
        now = time.monotonic()
        self._heard = now
        self._behavior = received.message.motor_behavior
        if self._behavior in self._goal.reached:
            self._since = self._since or now
            return
        undone, self._since = self._since is not None, None
        for asked in self._asked:
            asked.doubt(undone, now)

    def confirmed(self) -> str:
        """What the robot is known to be in, if that is what is meant."""
        if self._since is None or self._heard - self._since < LASTING:
            return ""
        return "brought to stand by comms_manager" if self._behavior == REFLEX else self._behavior

    def seen(self) -> str:
        """What is known of the motors."""
        if not self._heard:
            silent = "comms_manager is silent: what the motors do is unknown"
            return silent if self._node.discovery.connected else f"{silent}; {self._node.discovery.daemon_silent}"
        return f"the motors obey {self._behavior or 'nobody yet'}"


class _Ros:
    """The VRC, asked over ROS 2 by a process of its own."""

    def __init__(self, instance: Instance, goal: Goal, began: float) -> None:
        self.path = Path("valor_ros_controller, over ROS 2")
        self._began = began
        self._child = subprocess.Popen(
            [sys.executable, "-m", "valor.valorctl.ros_stop", instance.name, str(instance.folder.parent), *goal.modes],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )

    def advance(self) -> None:
        """Take in what it says when it ends."""
        if self.path.answer or self._child.poll() is None:
            return
        assert self._child.stdout is not None
        try:
            self.path.answer = msgspec.json.decode(self._child.stdout.read(), type=str)
        except msgspec.DecodeError:
            self.path.answer = f"could not be asked: ended with {self._child.returncode}"
        self.path.after = time.monotonic() - self._began

    def close(self, why: str) -> None:
        """Let it go."""
        self.advance()
        if not self.path.answer:
            self.path.answer = why
        if self._child.poll() is None:
            self._child.kill()
        self._child.wait()
