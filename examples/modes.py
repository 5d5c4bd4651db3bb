#!/usr/bin/env python3
"""Change the robot's control mode, and wait until it is in it:

    python modes.py stand_manipulate

The other examples import ``change_mode``.
"""

from __future__ import annotations

import sys

import rclpy
from rclpy.action import ActionClient
from rclpy.node import Node
from vigir_humanoid_control_msgs.action import ChangeControlMode
from vigir_humanoid_control_msgs.msg import ControlModeStatus

ACTION = "mode_controllers/control_mode_controller/change_control_mode"
REACHED = (ControlModeStatus.MODE_ACCEPTED, ControlModeStatus.MODE_DUPLICATE)
PATIENCE = 30.0  # [s]


def change_mode(node: Node, mode: str) -> None:
    """Ask for a control mode; ends the program with the reason if the robot does not take it."""
    client = ActionClient(node, ChangeControlMode, ACTION)
    if not client.wait_for_server(PATIENCE):
        sys.exit(f"no {ACTION}: is the robot up, and ROS_DOMAIN_ID the robot's?")
    goal = client.send_goal_async(ChangeControlMode.Goal(mode_request=mode))
    rclpy.spin_until_future_complete(node, goal, timeout_sec=PATIENCE)
    result = goal.result().get_result_async()
    rclpy.spin_until_future_complete(node, result, timeout_sec=PATIENCE)
    status = result.result().result.result
    if not any(status.status & flag for flag in REACHED) or status.current_control_mode != mode:
        sys.exit(f"mode {mode} not reached: status {status.status}, in {status.current_control_mode}")
    print(f"control mode {mode}", flush=True)


if __name__ == "__main__":
    rclpy.init()
    change_mode(rclpy.create_node("modes"), sys.argv[1])
    rclpy.shutdown()
