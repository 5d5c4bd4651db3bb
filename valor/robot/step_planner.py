"""A small footstep planner for level ground without obstacles: turn along the way, walk, turn.

The *middle* of the feet follows the way; a foot stands half a step width beside it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from valor.common.errors import ValorError
from valor.robot.motion_tables import Footsteps, Walking
from valor.robot.step_plan import FEET, PlanStep

STRIDE = 0.2  # of the middle, from step to step [m]
ASIDE = 0.1  # of both feet of a pair [m]
TURN = 0.25  # likewise [rad]
NEAR = 0.35  # as near as that, the robot goes without turning towards the goal [m]
THERE = (1e-6, 1e-9)  # less is no way, or no turn [m, rad]
SAFE = 0.9  # of a limit of the robot

Middle = tuple[float, float, float]  # x, y [m], yaw [rad]


def plan_to(goal: Middle, limits: Footsteps, walking: Walking) -> list[PlanStep]:
    """Steps that bring the middle of the feet to a goal, both in the frame of the middle as it is.

    Args:
        goal: x, y [m], yaw [rad].
        limits: of the robot.
        walking: its step width.

    Raises:
        ValorError: not finite, or more steps than a plan may have.
    """
    if not all(map(math.isfinite, goal)):
        raise ValorError(f"goal {goal}: expected finite numbers")
    x, y, yaw = goal
    yaw = math.remainder(yaw, math.tau)
    distance, bearing = math.hypot(x, y), math.atan2(y, x)
    width = walking.step_width
    ahead = math.sqrt(max(0.0, limits.max_distance**2 - width**2))  # of feet so far apart
    stride = min(STRIDE, SAFE * min(limits.max_forward, limits.max_backward, ahead))
    aside = min(ASIDE, SAFE * min(limits.max_backward, ahead, min(limits.max_width, limits.max_distance) - width))
    # By length before any step is made: a goal far away would be a long list.
    if distance > limits.max_steps * stride:
        raise ValorError(f"{distance:.1f} m is farther than a plan of {limits.max_steps} steps goes")
    if min(stride, aside) <= 0.0:
        raise ValorError(f"step_width {width:g} m: expected less than footsteps' max_width and max_distance")
    steps = _Steps(width, (stride, aside, min(TURN, SAFE * limits.max_yaw)))
    if distance < NEAR:
        # One after the other: a foot that leads to one side while it turns to the other steps on its neighbor.
        steps.shuffle((x, y, 0.0))
        steps.shuffle((x, y, yaw))
    else:
        if abs(bearing) > math.pi / 2.0:  # backwards: to turn round takes more steps than the way
            bearing = math.remainder(bearing + math.pi, math.tau)
        steps.shuffle((0.0, 0.0, bearing))
        steps.walk((x, y, bearing))
        steps.shuffle((x, y, bearing + math.remainder(yaw - bearing, math.tau)))
    if len(steps.made) > limits.max_steps:
        raise ValorError(f"the way takes {len(steps.made)} steps; a plan has at most {limits.max_steps}")
    return steps.made


class _Steps:
    """Steps as they are made, the feet in turn."""

    def __init__(self, width: float, largest: Sequence[float]) -> None:
        self.made: list[PlanStep] = []
        self._half = 0.5 * width
        self._stride, self._aside, self._turn = largest
        self._at: Middle = (0.0, 0.0, 0.0)
        self._foot: int | None = None  # whose turn it is; None: either's

    def _put(self, foot: int, place: Middle) -> None:
        x, y, yaw = place
        side = self._half if foot == 0 else -self._half
        self.made.append(
            PlanStep(foot=FEET[foot], x=x - side * math.sin(yaw), y=y + side * math.cos(yaw), yaw=yaw)  # type: ignore[arg-type]
        )
        self._foot, self._at = 1 - foot, place

    def walk(self, goal: Middle) -> None:
        """Straight ahead, each foot before the other, and side by side at the end."""
        x, y, _ = self._at
        count = math.ceil(math.hypot(goal[0] - x, goal[1] - y) / self._stride - 1e-9)
        foot = self._foot or 0
        for i in range(1, count + 1):
            s = i / count
            self._put(foot, (x + s * (goal[0] - x), y + s * (goal[1] - y), goal[2]))
            foot = 1 - foot
        self._put(foot, goal)

    def shuffle(self, goal: Middle) -> None:
        """Both feet in pairs, whichever way, the foot ahead on the side that it goes to."""
        x, y, yaw = self._at
        dx, dy, turn = goal[0] - x, goal[1] - y, goal[2] - yaw
        if math.hypot(dx, dy) < THERE[0] and abs(turn) < THERE[1]:
            return
        c, s = math.cos(yaw), math.sin(yaw)
        left = c * dy - s * dx
        leads = 0 if (left if abs(left) > THERE[0] else turn) > 0.0 else 1
        if self._foot is not None and self._foot != leads:
            self._put(self._foot, self._at)
        count = math.ceil(max(math.hypot(dx, dy) / self._aside, abs(turn) / self._turn) - 1e-9)
        for i in range(1, count + 1):
            share = i / count
            place = (x + share * dx, y + share * dy, yaw + share * turn)
            self._put(leads, place)
            self._put(1 - leads, place)
