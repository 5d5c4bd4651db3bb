"""The tasks by name: the world that each is in, who plans it, and what it comes to."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from valor.robot.description import RobotDescription
from valor.tasks import door, seen, valve
from valor.tasks.plan import Plan


@dataclass(frozen=True)
class Task:
    """One of them.

    Attributes:
        plan: of a robot and the seed of its world, by what is seen of that.
        shut: the world in which it does not give.
        fixture: the first joint of the world, that is turned.
        enough: to which it is turned, at least [rad].
    """

    plan: Callable[[RobotDescription, int], Plan]
    shut: str
    fixture: str
    enough: float


TASKS = {  # by their worlds' names
    door.NAME: Task(
        lambda robot, seed: door.plan(robot, seen.door(robot, seed)), "door_shut", "leaf", math.radians(10.0)
    ),
    valve.NAME: Task(
        lambda robot, seed: valve.plan(robot, seen.valve(robot, seed)), "valve_stuck", "wheel", valve.TURN
    ),
}
