"""Steps to a point on the floor, with the robot's rules for steps."""

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
from valor.robot.step_plan import plan_to


@dataclass(frozen=True)
class StepPreview:
    """Steps, each with foot (0 left, 1 right) and sole in odom, and the reasons for rejection."""

    steps: Sequence[tuple[int, Pose]]
    faults: Sequence[str]


def floor_point(origin: Sequence[float], direction: Sequence[float], height: float) -> tuple[float, float] | None:
    """Return where a ray from above meets the plane at a height [m], or None."""
    if direction[2] >= -1e-6 or origin[2] <= height:
        return None
    way = (height - origin[2]) / direction[2]
    return origin[0] + way * direction[0], origin[1] + way * direction[1]


def sole_poses(soles: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[Pose, Pose]:
    """Return left and right poses on level ground."""
    left, right = (
        level(float(place[0]), float(place[1]), float(place[2]), rotation.yaw(turn)) for place, turn in soles
    )
    return left, right


def walk_to(robot: RobotDescription, soles: tuple[Pose, Pose], goal: tuple[float, float]) -> StepPreview:
    """Plan steps that bring the middle of the feet to x, y in odom [m], ahead or turning if the goal is far.

    Raises:
        ValorError: the robot cannot step, or there is no path.
    """
    if (limits := robot.tables.footsteps) is None:
        raise ValorError(f"robot {robot.name!r} takes no footstep plans: its robot.yaml has no footsteps")
    here = middle(*soles)
    dx, dy = goal[0] - here.position[0], goal[1] - here.position[1]
    c, s = math.cos(here.yaw), math.sin(here.yaw)
    forward, left = c * dx + s * dy, c * dy - s * dx
    bearing = math.atan2(left, forward)
    turn = bearing if abs(bearing) <= 0.5 * math.pi and math.hypot(dx, dy) > 0.35 else 0.0
    planned = plan_to((forward, left, turn), limits, robot.tables.walking)
    if not planned:
        raise ValorError("the feet are there already")
    steps = [(FEET.index(step.foot), here @ step.sole) for step in planned]
    return StepPreview(steps, faults(robot, soles, steps))


def faults(robot: RobotDescription, soles: tuple[Pose, Pose], steps: Sequence[tuple[int, Pose]]) -> list[str]:
    """Return why the robot would reject steps."""
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


def sole_corners(robot: RobotDescription, foot: int, position: FloatArray, turn: FloatArray) -> FloatArray:
    """Return (4, 3) corners [m] from position (3,) [m] and rotation (3, 3)."""
    table = (robot.tables.feet.left, robot.tables.feet.right)[foot]
    x, y = np.array((table.toe, table.heel, table.heel, table.toe)), table.half_width * np.array((1.0, 1.0, -1.0, -1.0))
    placed: FloatArray = position + np.column_stack((x, y, np.zeros(4))) @ turn.T
    return placed
