"""Plan for a valve: the hand turns the wheel, between two spokes."""

import math
from collections.abc import Iterator

from valor.common.poses import Pose, level
from valor.common.rotation import rotate
from valor.manipulation.plan import HandMove, HandShape, Plan, require_reach
from valor.manipulation.seen import SeenValve
from valor.robot.description import RobotDescription

NAME = "valve"
FINGERS = "open"
AWAY = 0.52  # distance of the feet from the wheel [m]
ASIDE = 0.05  # distance of the shoulder from the wheel's centre, to its right [m]
BEFORE, THROUGH = 0.10, 0.11  # distance of the fingertips from the wheel's plane: waiting, turning [m]
CIRCLE = 0.6  # radius of the hand's path, share of the wheel's
TURN = math.radians(360.0)
STRIDE = math.radians(30.0)  # between goals
SLACK = math.radians(30.0)  # additional angle: the hand is narrower than the gap


def plan(robot: RobotDescription, seen: SeenValve) -> Plan:
    """Return the plan for one turn of a wheel in odom, clockwise for the robot; ``ValorError`` if it cannot."""
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
        """Hand pose by the distance of the fingertips from the wheel's plane [m], and the angle from y [rad]."""
        y, z = CIRCLE * seen.radius * math.cos(angle), CIRCLE * seen.radius * math.sin(angle)
        return seen.frame @ Pose((front - hand.front, y - hand.middle, seen.height + z))

    # The lowest gap: the arm approaches from below.
    middles = [seen.spoke + gap * (i + 0.5) for i in range(seen.spokes)]
    start = min(middles, key=math.sin)
    yield HandMove("reach out", at(-BEFORE, start), 8.0)
    yield HandMove("between the spokes", at(THROUGH, start), 6.0)
    way = TURN + gap / 2.0 + SLACK
    count = math.ceil(way / STRIDE)
    for i in range(1, count + 1):
        yield HandMove(f"turn by {math.degrees(way * i / count):.0f}°", at(THROUGH, start + way * i / count), 3.0)
    yield HandMove("let go", at(-BEFORE, start + way), 6.0)
