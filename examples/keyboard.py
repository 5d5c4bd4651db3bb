#!/usr/bin/env python3
"""Walk the robot with the keys w, s (ahead, back), a, d (turn), q, e (sideways); space stops, x ends.

A terminal does not tell when a key is let go: what was asked lasts half a second, a held key repeats itself.
"""

from __future__ import annotations

import select
import sys
import termios
import time
import tty

import rclpy
from geometry_msgs.msg import Twist
from modes import change_mode

LASTS = 0.5  # [s]; more than the pause before a held key repeats itself is asked for by pressing it again
KEYS = {  # ahead, left [m/s], turning left [rad/s]
    "w": (0.2, 0.0, 0.0), "s": (-0.1, 0.0, 0.0), "a": (0.0, 0.0, 0.3), "d": (0.0, 0.0, -0.3),
    "q": (0.0, 0.1, 0.0), "e": (0.0, -0.1, 0.0), " ": (0.0, 0.0, 0.0),
}  # fmt: skip


def main() -> None:
    """Read keys until x; whatever happens, the terminal is as before, and the robot is told to stop."""
    node = rclpy.create_node("keyboard")
    commands = node.create_publisher(Twist, "cmd_vel", 1)
    change_mode(node, "walk")
    print(__doc__, flush=True)
    before, until, asked, key = termios.tcgetattr(sys.stdin), 0.0, Twist(), ""
    tty.setcbreak(sys.stdin)
    try:
        while key != "x":
            key = sys.stdin.read(1) if select.select([sys.stdin], [], [], 0.1)[0] else ""
            if key in KEYS and key:
                asked.linear.x, asked.linear.y, asked.angular.z = KEYS[key]
                until = time.monotonic() + LASTS
            if time.monotonic() < until:
                commands.publish(asked)
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)
        commands.publish(Twist())
    change_mode(node, "stand")


if __name__ == "__main__":
    rclpy.init()
    main()
    rclpy.shutdown()
