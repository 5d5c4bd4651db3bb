"""Plan for a door: the fist presses the lever down, and the knuckles push the leaf."""

import math
from collections.abc import Iterator

from valor.common.poses import Pose, level
from valor.common.rotation import about_z, rotate
from valor.manipulation.plan import HandMove, HandShape, Plan, require_reach
from valor.manipulation.seen import SeenDoor
from valor.robot.description import RobotDescription

NAME = "door"
FINGERS = "close"
AWAY = 0.42  # distance of the feet from the leaf [m]
ASIDE = 0.07  # distance of the shoulder from the path of the hand, to its right [m]
ON_LEVER = 0.8  # position of the palm's middle, share of the lever from the spindle
BEFORE, OVER = 0.09, 0.10  # first goal: distance from the leaf, and height over the lever [m]
NEAR, ABOVE = 0.005, 0.045  # over the lever: distance from the leaf, and from the lever's axis [m]
BELOW = 0.045  # lever pressed: distance below its axis [m]
TURNS = tuple(math.radians(angle) for angle in (3.0, 6.0, 9.0, 12.0, 15.0))  # angles of the leaf, in order
PRESSING = 0.02  # depth of the goal behind the surface, so that the hand pushes [m]


def plan(robot: RobotDescription, seen: SeenDoor) -> Plan:
    """Return the plan that opens a door in odom; ``ValorError`` if the robot cannot."""
    hand = HandShape.of(robot, NAME, FINGERS)
    aside = ON_LEVER * seen.lever - hand.shoulder[1] - ASIDE
    stance = seen.frame @ level(-AWAY, aside, 0.0, 0.0)
    x, y, _ = stance.position
    out = rotate(seen.frame.orientation, (-BEFORE, 0.0, 0.0))
    made = Plan((x, y, stance.yaw), FINGERS, list(_moves(seen, hand)), out, "the leaf does not give")
    require_reach(NAME, made, hand)
    return made


def _moves(seen: SeenDoor, hand: HandShape) -> Iterator[HandMove]:
    side = ON_LEVER * seen.lever - hand.middle

    def at(front: float, bottom: float, turn: float = 0.0) -> Pose:
        """Hand pose by the distances of knuckles and leaf, lower edge and lever axis, and the leaf's angle."""
        inside = Pose((front - hand.front, side - seen.hinge, seen.handle_height + bottom - hand.bottom))
        about_hinge = Pose((0.0, seen.hinge, 0.0), about_z(turn))
        return seen.frame @ about_hinge @ inside

    yield HandMove("reach out", at(-BEFORE, OVER), 8.0)
    yield HandMove("over the lever", at(-NEAR, ABOVE), 6.0)
    yield HandMove("turn the lever", at(-NEAR, -BELOW), 5.0)
    for turn in TURNS:
        yield HandMove(f"push to {math.degrees(turn):.0f}°", at(PRESSING, -BELOW, turn), 3.0)
