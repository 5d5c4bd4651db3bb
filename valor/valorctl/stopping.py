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
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.linking import robots_hosts
from valor.common.stopping import HALT, LOCK, LONGEST, LONGEST_WITHOUT_ANSWER, Goal, MotionSystem, Path
from valor.valorctl.console import say, say_json
from valor.valorctl.interruption import Interruption
from valor.valorctl.plain_command import plain_command


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
        if robots_hosts(instance.settings()):
            from valor.valorctl import beyond_link

            stopped = Stop(*beyond_link.stop(instance, goal, interruption.check))
        else:
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
    network = bifrost.Network.load(instance.network_file, instance.keys)
    with bifrost.Node("valorctl", network=network, recall=True) as node, MotionSystem(node, goal, began) as system:
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


def _patience(goal: Goal, system: MotionSystem, ros_path: Path) -> float:
    """How long to go on trying [s]."""
    if any(path.after is not None for path in system.paths):
        return goal.longest
    return LONGEST if ros_path.answer else LONGEST_WITHOUT_ANSWER


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
