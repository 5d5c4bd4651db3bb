"""A click on the floor: where the feet would go, and which steps the robot would refuse."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.common.errors import ValorError
from valor.common.poses import Pose, level, middle
from valor.robot.description import RobotDescription
from valor.robot.footsteps import FEET, Step, StepRule
from valor.robot.step_planner import plan_to


@dataclass(frozen=True)
class StepPreview:
    """A way in steps.

    Attributes:
        steps: foot (0 left, 1 right) and sole in odom of each.
        faults: why the robot would refuse it; none: it would not.
    """

    steps: Sequence[tuple[int, Pose]]
    faults: Sequence[str]


def floor_point(origin: Sequence[float], direction: Sequence[float], height: float) -> tuple[float, float] | None:
    """Where a ray meets the level plane at a height, seen from above [m]; None: nowhere ahead of it."""
    if direction[2] >= -1e-6 or origin[2] <= height:
        return None
    way = (height - origin[2]) / direction[2]
    return origin[0] + way * direction[0], origin[1] + way * direction[1]


def sole_poses(soles: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[Pose, Pose]:
    """Of positions and rotations, left and right, as they stand on level ground."""
    left, right = (
        level(float(place[0]), float(place[1]), float(place[2]), rotation.yaw(turn)) for place, turn in soles
    )
    return left, right


def walk_to(
    robot: RobotDescription, soles: tuple[Pose, Pose], goal: tuple[float, float], yaw: float | None = None
) -> StepPreview:
    """Steps that bring the middle of the feet to a place.

    Args:
        robot: the robot.
        soles: left and right, in odom.
        goal: x, y in odom [m].
        yaw: heading there in odom [rad]; None: along the way.

    Raises:
        ValorError: the robot takes no steps, or there is no way.
    """
    if (limits := robot.tables.footsteps) is None:
        raise ValorError(f"robot {robot.name!r} takes no footstep plans: its robot.yaml has no footsteps")
    here = middle(*soles)
    dx, dy = goal[0] - here.position[0], goal[1] - here.position[1]
    c, s = math.cos(here.yaw), math.sin(here.yaw)
    forward, left = c * dx + s * dy, c * dy - s * dx
    if yaw is not None:
        turn = yaw - here.yaw
    else:
        bearing = math.atan2(left, forward)
        turn = bearing if abs(bearing) <= 0.5 * math.pi and math.hypot(dx, dy) > 0.35 else 0.0
    planned = plan_to((forward, left, turn), limits, robot.tables.walking)
    if not planned:
        raise ValorError("the feet are there already")
    steps = [(FEET.index(step.foot), here @ step.sole) for step in planned]
    return StepPreview(steps, faults(robot, soles, steps))


def faults(robot: RobotDescription, soles: tuple[Pose, Pose], steps: Sequence[tuple[int, Pose]]) -> list[str]:
    """Why the robot would refuse steps, by the rule that it goes by itself."""
    assert robot.tables.footsteps is not None
    rule = StepRule(robot.tables.footsteps, robot.tables.feet)
    stand = list(soles)
    found = []
    for index, (foot, sole) in enumerate(steps):
        step = Step(index, foot, sole, 0.0, 0.0, 0.0)
        if fault := rule.alone(step) or rule.beside(step, stand[1 - foot]):
            found.append(fault)
        stand[foot] = sole
    return found


def outline_of(robot: RobotDescription, foot: int, sole: Pose) -> FloatArray:
    """(4, 3) corners of a sole in odom [m]."""
    return sole_corners(robot, foot, np.array(sole.position), np.array(sole.rotation))


def sole_corners(robot: RobotDescription, foot: int, position: FloatArray, turn: FloatArray) -> FloatArray:
    """(4, 3) likewise, of its position (3,) [m] and rotation (3, 3)."""
    table = (robot.tables.feet.left, robot.tables.feet.right)[foot]
    x, y = np.array((table.toe, table.heel, table.heel, table.toe)), table.half_width * np.array((1.0, 1.0, -1.0, -1.0))
    placed: FloatArray = position + np.column_stack((x, y, np.zeros(4))) @ turn.T
    return placed
