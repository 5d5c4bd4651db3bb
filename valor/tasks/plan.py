"""A plan of a task: a stance, and goals of one hand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from valor.common.errors import ValorError
from valor.common.poses import Pose, level
from valor.common.rotation import Vector
from valor.robot.step_planner import Middle
from valor.tasks.hand_shape import HandShape

REACHED, RESISTED = "reached", "resisted"  # states of a hand, as HandGoalStatus has them
PATIENCE = 8.0  # of a retreat [robot time, s]
STRETCH = 0.97  # most of an arm's length that a goal may be from its shoulder


@dataclass(frozen=True)
class HandMove:
    """A goal of the hand.

    Attributes:
        name: of what is done by it.
        hand: the hand's site in odom.
        patience: after which the next one comes, reached or not [robot time, s].
    """

    name: str
    hand: Pose
    patience: float


@dataclass(frozen=True)
class Plan:
    """All of it.

    Attributes:
        stance: where the middle of the feet shall be in odom, x, y [m], yaw [rad].
        fingers: the hand's preset.
        moves: of the right hand, in their order.
        out: from where the hand works to where it is off everything, in odom [m].
        resisted: what it means that the hand presses in vain.
    """

    stance: Middle
    fingers: str
    moves: Sequence[HandMove]
    out: Vector
    resisted: str

    def retreat(self, move: HandMove) -> tuple[HandMove, HandMove]:
        """Back to where a move ended that was reached, and straight out from there."""
        x, y, z = (place + out for place, out in zip(move.hand.position, self.out, strict=True))
        away = Pose((x, y, z), move.hand.orientation)
        return HandMove("back", move.hand, PATIENCE), HandMove("off", away, PATIENCE)


def require_reach(task: str, plan: Plan, hand: HandShape) -> None:
    """Look whether the arm is long enough, before anything moves.

    Raises:
        ValorError: it is not; says by how much.
    """
    x, y, yaw = plan.stance
    shoulder = (level(x, y, 0.0, yaw) @ Pose(hand.shoulder)).position
    far, name = max((math.dist(shoulder, move.hand.position), move.name) for move in plan.moves)
    if far > STRETCH * hand.arm:
        raise ValorError(
            f"{task}: the right arm of {hand.robot!r} is {hand.arm:.2f} m long; expected at least {far / STRETCH:.2f} "
            f"m, for {name!r} is {far:.2f} m from its shoulder"
        )
