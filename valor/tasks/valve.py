"""A valve's wheel, turned: the hand between two spokes, round and round."""

from __future__ import annotations

import math
from collections.abc import Iterator

from valor.common.poses import Pose, level
from valor.common.rotation import rotate
from valor.robot.description import RobotDescription
from valor.tasks.hand_shape import HandShape
from valor.tasks.plan import HandMove, Plan, require_reach
from valor.tasks.seen import SeenValve

NAME = "valve"
FINGERS = "open"
AWAY = 0.52  # of the feet from the wheel [m]
ASIDE = 0.05  # of the shoulder from the wheel's middle, to its right [m]
BEFORE, THROUGH = 0.10, 0.11  # of the fingertips, from the wheel's plane: waiting, turning [m]
CIRCLE = 0.6  # of the wheel's radius, on which the hand goes
TURN = math.radians(360.0)
STRIDE = math.radians(30.0)  # from goal to goal
SLACK = math.radians(30.0)  # more than the gap that the hand goes further, for it is wide and spokes are thin


def plan(robot: RobotDescription, seen: SeenValve) -> Plan:
    """To turn it once, clockwise as the robot sees it.

    Args:
        robot: that shall.
        seen: the wheel in odom.

    Raises:
        ValorError: the robot lacks what that needs, or its arm is too short.
    """
    hand = HandShape.of(robot, NAME, FINGERS)
    stance = seen.frame @ level(-AWAY, -hand.shoulder[1] - ASIDE, 0.0, 0.0)
    x, y, _ = stance.position
    out = rotate(seen.frame.orientation, (-BEFORE - THROUGH, 0.0, 0.0))
    made = Plan((x, y, stance.yaw), FINGERS, list(_moves(seen, hand)), out, "the wheel does not turn")
    require_reach(NAME, made, hand)
    return made


def _moves(seen: SeenValve, hand: HandShape) -> Iterator[HandMove]:
    gap = math.tau / seen.spokes

    def at(front: float, angle: float) -> Pose:
        """The hand's place: fingertips from the wheel's plane, about the axis from y [rad]."""
        y, z = CIRCLE * seen.radius * math.cos(angle), CIRCLE * seen.radius * math.sin(angle)
        return seen.frame @ Pose((front - hand.front, y - hand.middle, seen.height + z))

    # Of the middles of the gaps the one that is lowest: the arm gets there from below.
    middles = [seen.spoke + gap * (i + 0.5) for i in range(seen.spokes)]
    start = min(middles, key=math.sin)
    yield HandMove("reach out", at(-BEFORE, start), 8.0)
    yield HandMove("between the spokes", at(THROUGH, start), 6.0)
    way = TURN + gap / 2.0 + SLACK
    count = math.ceil(way / STRIDE)
    for i in range(1, count + 1):
        yield HandMove(f"turn by {math.degrees(way * i / count):.0f}°", at(THROUGH, start + way * i / count), 3.0)
    yield HandMove("let go", at(-BEFORE, start + way), 6.0)
