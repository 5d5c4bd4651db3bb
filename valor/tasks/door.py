"""Through a door: to its handle, the lever pressed down by the fist, the leaf pushed by its knuckles."""

from __future__ import annotations

import math
from collections.abc import Iterator

from valor.common.poses import Pose, level
from valor.common.rotation import about_z, rotate
from valor.robot.description import RobotDescription
from valor.tasks.hand_shape import HandShape
from valor.tasks.plan import HandMove, Plan, require_reach
from valor.tasks.seen import SeenDoor

NAME = "door"
FINGERS = "close"
AWAY = 0.42  # of the feet from the leaf [m]
ASIDE = 0.07  # of the shoulder from the hand's way, to its right [m]
ON_LEVER = 0.8  # of the lever's length, from the spindle: above there the palm's middle is
BEFORE, OVER = 0.09, 0.10  # the hand waits so far before the leaf and above the lever [m]
NEAR, ABOVE = 0.005, 0.045  # above the lever, from the leaf and from its axis [m]
BELOW = 0.045  # that the hand goes under the lever's axis [m]
TURNS = tuple(math.radians(angle) for angle in (3.0, 6.0, 9.0, 12.0, 15.0))  # of the leaf, by turns
PRESSING = 0.02  # the hand is told to be so far in the leaf that it pushes [m]


def plan(robot: RobotDescription, seen: SeenDoor) -> Plan:
    """To open it.

    Args:
        robot: that shall.
        seen: the door in odom.

    Raises:
        ValorError: the robot lacks what that needs, or its arm is too short.
    """
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
        """The hand's place: its knuckles from the leaf, its lower edge from the lever's axis, the leaf turned."""
        inside = Pose((front - hand.front, side - seen.hinge, seen.handle_height + bottom - hand.bottom))
        about_hinge = Pose((0.0, seen.hinge, 0.0), about_z(turn))
        return seen.frame @ about_hinge @ inside

    yield HandMove("reach out", at(-BEFORE, OVER), 8.0)
    yield HandMove("over the lever", at(-NEAR, ABOVE), 6.0)
    yield HandMove("turn the lever", at(-NEAR, -BELOW), 5.0)
    for turn in TURNS:
        yield HandMove(f"push to {math.degrees(turn):.0f}°", at(PRESSING, -BELOW, turn), 3.0)
