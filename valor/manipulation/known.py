"""Table of the tasks: world, planning function, fixture and success criterion."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from valor.manipulation import door, seen, valve
from valor.manipulation.plan import Plan
from valor.robot.description import RobotDescription


@dataclass(frozen=True)
class Task:
    """A row of the table."""

    plan: Callable[[RobotDescription, int], Plan]  # for a robot and the seed of its world
    blocked: str  # name of the world in which the fixture does not move
    fixture: str  # the first joint of the world
    enough: float  # rotation for success, at least [rad]


TASKS = {  # by the names of their worlds
    door.NAME: Task(
        lambda robot, seed: door.plan(robot, seen.door(robot, seed)), "door_shut", "leaf", math.radians(10.0)
    ),
    valve.NAME: Task(
        lambda robot, seed: valve.plan(robot, seen.valve(robot, seed)), "valve_stuck", "wheel", valve.TURN
    ),
}
