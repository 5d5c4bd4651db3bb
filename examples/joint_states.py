#!/usr/bin/env python3
"""Print where the joints are, once a second; ``python joint_states.py 3`` ends after three times."""

from __future__ import annotations

import sys

import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState


class Printer(Node):
    """Keeps the newest joint states, and prints them once a second."""

    def __init__(self) -> None:
        super().__init__("joint_state_printer")
        self.printed = 0
        self._newest: JointState | None = None
        self.create_subscription(JointState, "joint_states", self._hear, qos_profile_sensor_data)
        self.create_timer(1.0, self._print)

    def _hear(self, state: JointState) -> None:
        self._newest = state

    def _print(self) -> None:
        if (state := self._newest) is None:
            print("nothing yet: is the robot up, and ROS_DOMAIN_ID the robot's?", file=sys.stderr)
            return
        self._newest, self.printed = None, self.printed + 1
        print(f"robot time {state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec:.3f} s")
        for name, position, velocity, effort in zip(
            state.name, state.position, state.velocity, state.effort, strict=True
        ):
            print(f"  {name:24} {position:7.3f} rad {velocity:7.3f} rad/s {effort:8.2f} N·m", flush=True)


if __name__ == "__main__":
    times = float(sys.argv[1]) if len(sys.argv) > 1 else float("inf")
    rclpy.init()
    printer = Printer()
    while printer.printed < times:
        rclpy.spin_once(printer)
    rclpy.shutdown()
