#!/usr/bin/env python3
"""Walk ahead for some seconds, and stand: ``python walk_and_stop.py 0.2 5`` [m/s, s].

The robot stops by itself 0.5 s after the last /cmd_vel: who walks it says so again and again.
"""

from __future__ import annotations

import sys

import rclpy
from geometry_msgs.msg import Twist
from modes import change_mode
from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data

PERIOD = 0.1  # between two commands [s]


def main(speed: float, seconds: float) -> None:
    """Walk and stop; times are the robot's, of the stamps that it sends."""
    node = rclpy.create_node("walk_and_stop")
    commands = node.create_publisher(Twist, "cmd_vel", 1)
    odometry: list[Odometry] = []
    node.create_subscription(Odometry, "odom", odometry.append, qos_profile_sensor_data)
    change_mode(node, "walk")
    while not odometry:
        rclpy.spin_once(node)
    start, asked = odometry[-1], Twist()
    asked.linear.x = speed
    node.create_timer(PERIOD, lambda: commands.publish(asked))
    while time_of(odometry[-1]) - time_of(start) < seconds:
        rclpy.spin_once(node)
    asked.linear.x = 0.0
    commands.publish(asked)
    change_mode(node, "stand")
    end = odometry[-1]
    print(f"walked {end.pose.pose.position.x - start.pose.pose.position.x:.2f} m along odom's x")


def time_of(odometry: Odometry) -> float:
    """Its stamp [s]."""
    return odometry.header.stamp.sec + 1e-9 * odometry.header.stamp.nanosec


if __name__ == "__main__":
    rclpy.init()
    main(float(sys.argv[1]), float(sys.argv[2]))
    rclpy.shutdown()
