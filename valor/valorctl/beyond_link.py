"""The robot as verbs on the operator's side of a deployment reach it: through the link, over ROS 2.

What is known of it there is what ``/link/status`` tells, with its age.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty
from vigir_humanoid_control_msgs.action import ChangeControlMode
from vigir_humanoid_control_msgs.msg import ControlModeStatus

from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.messages import ControlModeReport
from valor.common.stopping import LOCK, Goal, Path
from valor.link.classes import BY_KIND, Kind
from valor.valorctl.control_mode import ACTION
from valor.valorctl.ros_client import RosClient

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
TIMEOUT = 20.0  # for the first word of the operator's end [s]
AGAIN = 1.0  # between two soft stops, until the robot has stopped [s]
LONGEST = (BY_KIND[Kind.STOP].deadline or 0.0) + 5.0  # until a stop has been obeyed and that is seen, or never [s]


class _Told:
    """The newest of what the operator's end tells."""

    def __init__(self, ros: RosClient) -> None:
        self._values: dict[str, str] = {}
        self.mode: Any = None
        ros.subscribe(DiagnosticStatus, "link/status", self._hear, LATCHED)
        ros.subscribe(ControlModeStatus, "flor/controller/mode", self._hear_mode, LATCHED)
        ros.wait(lambda: bool(self._values), TIMEOUT, "link_operator is silent: no /link/status")

    def _hear(self, message: DiagnosticStatus) -> None:
        self._values = {"": message.message} | {pair.key: pair.value for pair in message.values}

    def _hear_mode(self, message: ControlModeStatus) -> None:
        self.mode = message

    def text(self, key: str = "") -> str:
        """A value, or how the link is; empty: it is not told."""
        return self._values.get(key, "")

    def age(self, key: str) -> float:
        """A value [s]; inf: it is not told."""
        return float(self._values.get(key, "inf"))


def mode(instance: Instance) -> tuple[ControlModeReport, float]:
    """The robot's control mode, and how old that is at most [s].

    Raises:
        ValorError: the robot has not been heard.
    """
    with RosClient(instance) as ros:
        told = _Told(ros)
        ros.wait(lambda: told.mode is not None and bool(told.text("mode")), TIMEOUT, f"{told.text()}: no mode")
        stamp = told.mode.header.stamp
        report = ControlModeReport(
            time=stamp.sec * 10**9 + stamp.nanosec,
            current_control_mode=told.mode.current_control_mode,
            requested_control_mode=told.mode.requested_control_mode,
            status=told.mode.status, behavior=told.text("behavior"),
        )  # fmt: skip
        return report, told.age("mode_age")


@contextmanager
def joints(instance: Instance) -> Iterator[Callable[[], dict[str, float]]]:
    """What waits for the next joint positions [rad] that come through the link.

    Raises:
        ValorError: none come.
    """
    with RosClient(instance) as ros:
        heard: list[JointState] = []
        ros.subscribe(JointState, "joint_states", heard.append, 1)

        def positions() -> dict[str, float]:
            heard.clear()
            ros.wait(lambda: bool(heard), TIMEOUT, "link_operator is silent: no /joint_states")
            return dict(zip(heard[-1].name, heard[-1].position, strict=True))

        yield positions


def stop(instance: Instance, goal: Goal, check: Callable[[], None]) -> tuple[str, float, str, list[Path]]:
    """Stop the robot through the link.

    Returns:
        ``Stop``'s fields: confirmed is what the robot has told since it was asked.
    """
    began = time.monotonic()
    path = Path("link_robot, through the link")
    with RosClient(instance, check) as ros:
        told = _Told(ros)
        publisher = None if goal is LOCK else ros.publisher(Empty, "flor/controller/soft_stop", 1)
        path.answer = "soft stop sent"
        if goal is LOCK:
            asked = ChangeControlMode.Goal(mode_request=goal.modes[0])
            result = ros.call_action(ChangeControlMode, ACTION, asked, LONGEST + goal.longest).result
            path.answer = f"control mode {result.current_control_mode}"
        due = began

        def stopped() -> bool:
            nonlocal due
            if publisher is not None and time.monotonic() >= due:  # again: the other end may not have found it before
                publisher.publish(Empty())
                due = time.monotonic() + AGAIN
            new = told.age("behavior_age") < time.monotonic() - began
            return new and told.text("behavior") in goal.reached

        try:
            ros.wait(stopped, LONGEST, "")
        except ValorError:
            seen = f"behavior {told.text('behavior') or 'not known'}, {told.age('behavior_age'):.1f} s old at most"
            return "", 0.0, f"{told.text()}; {seen}", [path]
        path.after = time.monotonic() - began
        return told.text("behavior"), path.after, "", [path]
