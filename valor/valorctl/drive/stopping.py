"""`stop`: stops the robot by all paths concurrently; any part of the system may be down.

Over Bifrost the request goes to the Motion Manager and to the Comms Manager, which stops the robot if no Motion Manager
does; over ROS, to the VRC, from a separate process: importing rclpy takes 0.5 s. A stop is confirmed only by what the
Comms Manager reports of the motors.
"""

import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import msgspec

import bifrost
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.linking import robots_hosts
from valor.common.stopping import LONGEST, LONGEST_WITHOUT_ANSWER, MotionSystem, StopGoal, StopRoute
from valor.valorctl.terminal.console import Interruption, say, say_json


class Stop(NamedTuple):
    """Result of a stop."""

    state: str  # confirmed behavior; empty: the stop is not confirmed
    after: float  # time from request to confirmation [s]
    seen: str  # latest report of the robot, if the stop is not confirmed
    paths: list[StopRoute]  # tried

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
        """One line for each path."""
        return [
            f"  {path.name}: {path.answer or 'no answer'}" + (f" ({path.after * 1e3:.0f} ms)" if path.after else "")
            for path in self.paths
        ]


def run(instance: Instance, goal: StopGoal, json: bool) -> None:
    """Stop the robot and print the result; raises ``ValorError`` if the stop is not confirmed."""
    with Interruption() as interruption:
        if robots_hosts(instance.settings()):
            from valor.valorctl.drive.ros_stop import stop_through_link

            stopped = Stop(*stop_through_link(instance, goal, interruption.check))
        else:
            stopped = stop(instance, goal, interruption.check)
    if json:
        say_json(stopped.as_json())
    elif stopped.state:
        say("\n".join([f"stopped after {stopped.after:.2f} s: {stopped.state}", *stopped.lines()]))
    if not stopped.state:
        raise ValorError("\n".join([f"not confirmed to have stopped: {stopped.seen}", *stopped.lines()]))


def stop(instance: Instance, goal: StopGoal, check: Callable[[], None] = lambda: None) -> Stop:
    """Stop the robot; one working path is enough, and no supervisor is needed.

    ``check`` may raise; the request stays in effect. Raises ``ConfigurationError``: the instance is not up.
    """
    began = time.monotonic()
    instance.settings()
    network = bifrost.Network.load(instance.network_file, instance.keys)
    with bifrost.Node("valorctl", network=network, recall=True) as node, MotionSystem(node, goal, began) as system:
        system.advance()
        ros = _Ros(instance, goal, began)
        try:
            while not (state := system.confirmed()):
                if time.monotonic() - began > _timeout(goal, system, ros.path):
                    break
                check()
                system.wait()
                system.advance()
                if system.obeys:
                    ros.close("not needed")  # the VRC would send the same request to the Motion Manager
                ros.advance()
        finally:
            ros.close("not needed" if system.confirmed() else "")
        return Stop(state, time.monotonic() - began, system.seen(), [*system.paths, ros.path])


def _timeout(goal: StopGoal, system: MotionSystem, ros_path: StopRoute) -> float:
    """Timeout [s]."""
    if any(path.after is not None for path in system.paths):
        return goal.longest
    return LONGEST if ros_path.answer else LONGEST_WITHOUT_ANSWER


class _Ros:
    def __init__(self, instance: Instance, goal: StopGoal, began: float) -> None:
        self.path = StopRoute("valor_ros_controller, over ROS 2")
        self._began = began
        self._child = subprocess.Popen(
            [sys.executable, "-m", "valor.valorctl.drive.ros_stop", instance.name, instance.folder.parent, *goal.modes],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )

    def advance(self) -> None:
        """Read the answer when the process has ended."""
        if self.path.answer or self._child.poll() is None:
            return
        assert self._child.stdout is not None
        try:
            self.path.answer = msgspec.json.decode(self._child.stdout.read(), type=str)
        except msgspec.DecodeError:
            self.path.answer = f"no request: the process ended with {self._child.returncode}"
        self.path.after = time.monotonic() - self._began

    def close(self, why: str) -> None:
        """End the process."""
        self.advance()
        if not self.path.answer:
            self.path.answer = why
        if self._child.poll() is None:
            self._child.kill()
        self._child.wait()
