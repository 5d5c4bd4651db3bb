"""The robot on the other side of a link, over ROS 2: ``link_operator`` carries the stop, and reports the state."""

from __future__ import annotations

import threading
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from msgspec import structs
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Empty

from valor.common.stopping import HALT
from valor.operator_stop.robot import described
from valor.ros.node import RosSide
from valor.ros.taking import polled, waiting
from valor.service import Context

_LONGEST = 10.0  # until a stop is confirmed [s]
_REPEAT = 1.0  # of the soft stop [s]


class LinkedRobot:
    """As ``BifrostRobot``."""

    def __init__(self, context: Context) -> None:
        settings = context.settings
        joined = structs.replace(settings, ros_domain_id=settings.link.domain or settings.ros_domain_id)
        self._side = RosSide(context.name, joined, context.instance.environment(), context.arguments, sim_time=False)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._statuses = polled(self._side.node, DiagnosticStatus, "link/status", latched)
        self._stop = self._side.node.create_publisher(Empty, "flor/controller/soft_stop", 1)
        self._lock = threading.Lock()
        self._status: dict[str, str] = {}
        self._arrived = 0.0  # of the status, monotonic [s]
        self._side.life.configure()
        self._side.life.set_ready(True)

    def turn(self) -> None:
        """Receive the link's status."""
        with self._lock:
            self._side.serve_pending()
            for status in waiting(self._statuses):
                self._status = {pair.key: pair.value for pair in status.values}
                self._arrived = time.monotonic()

    def state(self) -> dict[str, Any]:
        """Return the latest state."""
        with self._lock:
            age = time.monotonic() - self._arrived + float(self._status.get("behavior_age", "inf"))
            return described("", self._status.get("behavior", ""), age if age < float("inf") else None)

    def stop(self) -> tuple[bool, str]:
        """Send the stop until the robot reports it; returns whether it has, and a text."""
        began, due = time.monotonic(), 0.0
        while (now := time.monotonic()) - began < _LONGEST:
            if now >= due:
                self._stop.publish(Empty())
                due = now + _REPEAT
            state = self.state()
            if state["age"] is not None and state["age"] < now - began and state["behavior"] in HALT.reached:
                return True, f"confirmed through the link: stopped after {now - began:.2f} s ({state['behavior']})"
            time.sleep(0.05)
        return False, f"NOT confirmed through the link: behavior {state['behavior']}; use the robot's own stop"

    def close(self) -> None:
        """Leave ROS."""
        self._side.close()
