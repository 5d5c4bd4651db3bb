"""Footstep plans: YAML files, and a planner for level ground, along paths of the *middle* of the feet."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta

from valor.common.errors import ValorError
from valor.common.poses import Pose, level
from valor.common.table import Table, read
from valor.robot.motion_tables import Footsteps, Walking

FEET: tuple[Literal["left"], Literal["right"]] = ("left", "right")
START = "feet"  # frame midway between the present soles
STRIDE = 0.2  # of the middle per step [m]
ASIDE = 0.1  # of a pair of steps [m]
TURN = 0.25  # of a pair of steps [rad]
NEAR = 0.35  # distance up to which the robot does not turn towards the goal [m]
THERE = (1e-6, 1e-9)  # zero distance and angle [m, rad]
SAFE = 0.9  # used share of the robot's limits

Middle = tuple[float, float, float]  # x, y [m], yaw [rad]


class PlanStep(Table):
    """Pose of a sole in the plan's frame."""

    foot: Literal["left", "right"]
    x: float  # [m]
    y: float  # [m]
    z: float = 0.0  # [m]
    yaw: float = 0.0  # [rad]
    swing_height: float = 0.0  # [m]; 0: the robot's default
    step_duration: float = 0.0  # of the swing [s]; 0: the robot's default
    sway_duration: float = 0.0  # of the double support before it [s]; 0: the robot's default

    @property
    def sole(self) -> Pose:
        """Pose in the plan's frame."""
        return level(self.x, self.y, self.z, self.yaw)


class StepPlanFile(Table, kw_only=True):
    """Content of a plan file."""

    description: str = ""
    frame: Annotated[str, Meta(min_length=1)] = START  # or a tf frame, such as odom
    steps: Annotated[list[PlanStep], Meta(min_length=1)]


def load(file: Path) -> StepPlanFile:
    """Read a plan. Raises ConfigurationError with file and key."""
    return read(StepPlanFile, file)


def plan_to(goal: Middle, limits: Footsteps, walking: Walking) -> list[PlanStep]:
    """Plan steps on level ground to a pose of the middle of the feet: turn along the path, walk, turn.

    Raises ValorError: the goal is not finite, or needs too many steps.
    """
    if not all(map(math.isfinite, goal)):
        raise ValorError(f"goal {goal}: expected finite numbers")
    x, y, yaw = goal
    yaw = math.remainder(yaw, math.tau)
    distance, bearing = math.hypot(x, y), math.atan2(y, x)
    width = walking.step_width
    ahead = math.sqrt(max(0.0, limits.max_distance**2 - width**2))  # reach at this width
    stride = min(STRIDE, SAFE * min(limits.max_forward, limits.max_backward, ahead))
    aside = min(ASIDE, SAFE * min(limits.max_backward, ahead, min(limits.max_width, limits.max_distance) - width))
    # Checked before planning: a distant goal would be a long list.
    if distance > limits.max_steps * stride:
        raise ValorError(f"{distance:.1f} m exceeds a plan of {limits.max_steps} steps")
    if min(stride, aside) <= 0.0:
        raise ValorError(f"step_width {width:g} m: expected less than footsteps' max_width and max_distance")
    steps = _Steps(width, (stride, aside, min(TURN, SAFE * limits.max_yaw)))
    if distance < NEAR:
        # In sequence: combined sideways and turning steps could collide.
        steps.shuffle((x, y, 0.0))
        steps.shuffle((x, y, yaw))
    else:
        if abs(bearing) > math.pi / 2.0:  # backwards: turning round would take more steps
            bearing = math.remainder(bearing + math.pi, math.tau)
        steps.shuffle((0.0, 0.0, bearing))
        steps.walk((x, y, bearing))
        steps.shuffle((x, y, bearing + math.remainder(yaw - bearing, math.tau)))
    if len(steps.made) > limits.max_steps:
        raise ValorError(f"the path takes {len(steps.made)} steps; expected at most {limits.max_steps}")
    return steps.made


class _Steps:
    """Plan under construction, with alternating feet."""

    def __init__(self, width: float, largest: Sequence[float]) -> None:
        self.made: list[PlanStep] = []
        self._half = 0.5 * width
        self._stride, self._aside, self._turn = largest
        self._at: Middle = (0.0, 0.0, 0.0)
        self._foot: int | None = None  # next foot; None: either

    def _put(self, foot: int, pose: Middle) -> None:
        x, y, yaw = pose
        side = self._half if foot == 0 else -self._half
        self.made.append(PlanStep(foot=FEET[foot], x=x - side * math.sin(yaw), y=y + side * math.cos(yaw), yaw=yaw))
        self._foot, self._at = 1 - foot, pose

    def walk(self, goal: Middle) -> None:
        """Walk straight to a goal; end with the feet side by side."""
        x, y, _ = self._at
        count = math.ceil(math.hypot(goal[0] - x, goal[1] - y) / self._stride - 1e-9)
        foot = self._foot or 0
        for i in range(1, count + 1):
            s = i / count
            self._put(foot, (x + s * (goal[0] - x), y + s * (goal[1] - y), goal[2]))
            foot = 1 - foot
        self._put(foot, goal)

    def shuffle(self, goal: Middle) -> None:
        """Move and turn by pairs of steps; the foot on the side of the motion goes first."""
        x, y, yaw = self._at
        dx, dy, turn = goal[0] - x, goal[1] - y, goal[2] - yaw
        if math.hypot(dx, dy) < THERE[0] and abs(turn) < THERE[1]:
            return
        c, s = math.cos(yaw), math.sin(yaw)
        left = c * dy - s * dx
        first = 0 if (left if abs(left) > THERE[0] else turn) > 0.0 else 1
        if self._foot is not None and self._foot != first:
            self._put(self._foot, self._at)
        count = math.ceil(max(math.hypot(dx, dy) / self._aside, abs(turn) / self._turn) - 1e-9)
        for i in range(1, count + 1):
            share = i / count
            pose = (x + share * dx, y + share * dy, yaw + share * turn)
            self._put(first, pose)
            self._put(1 - first, pose)
