#!/usr/bin/env python3
"""Walk the robot with a gamepad on this computer: ``python gamepad.py /dev/input/js0``.

While L1 is held, the left stick walks and the right one turns; let go, the robot stops. Start walks, Select stands.
Numbers of axes and buttons are those of Linux' driver for Xbox and PlayStation pads.
"""

from __future__ import annotations

import os
import select
import struct
import sys
import time

import rclpy
from geometry_msgs.msg import Twist
from modes import change_mode

EVENT = struct.Struct("IhBB")  # Linux' joystick API: time [ms], value, type, number
BUTTON, AXIS, INITIAL = 0x01, 0x02, 0x80
L1, SELECT, START = 4, 6, 7
LEFT_X, LEFT_Y, RIGHT_X = 0, 1, 3
FASTEST = (0.25, 0.1, 0.4)  # ahead, left [m/s], turning [rad/s]
PERIOD = 0.1  # between two commands [s]


def main(device: str) -> None:
    """Until the gamepad goes."""
    node = rclpy.create_node("gamepad")
    commands = node.create_publisher(Twist, "cmd_vel", 1)
    axes, held, due = dict.fromkeys((LEFT_X, LEFT_Y, RIGHT_X), 0.0), False, 0.0
    pad = os.open(device, os.O_RDONLY)
    while True:
        if select.select([pad], [], [], PERIOD)[0]:
            if len(data := os.read(pad, EVENT.size)) < EVENT.size:
                break
            _, value, kind, number = EVENT.unpack(data)
            if kind & ~INITIAL == AXIS and number in axes:
                axes[number] = value / 32767.0
            elif kind & ~INITIAL == BUTTON and number == L1:
                held = bool(value)
                commands.publish(Twist())  # let go: stop
            elif kind == BUTTON and value and number in (START, SELECT):
                change_mode(node, "walk" if number == START else "stand")
        if held and time.monotonic() >= due:
            due, asked = time.monotonic() + PERIOD, Twist()
            asked.linear.x, asked.linear.y = -FASTEST[0] * axes[LEFT_Y], -FASTEST[1] * axes[LEFT_X]
            asked.angular.z = -FASTEST[2] * axes[RIGHT_X]
            commands.publish(asked)
    commands.publish(Twist())


if __name__ == "__main__":
    rclpy.init()
    main(sys.argv[1])
    rclpy.shutdown()
