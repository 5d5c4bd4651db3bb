"""``demo door``, ``demo valve``: the robot walks up, and its hand opens the one and turns the other; one bag."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path

from valor.common.behaviors import ControlMode
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.topics import GROUND_TRUTH
from valor.robot.description import RobotDescription
from valor.tasks.known import TASKS
from valor.tasks.plan import Plan
from valor.valorctl import arm_motion, control_mode, demonstration, hand_motion, instance_setup, startup, stepping
from valor.valorctl.console import Progress
from valor.valorctl.instance_setup import Request
from valor.valorctl.interruption import Interruption
from valor.valorctl.node import hear, join

_FINGERS = (0.5, 0.2)  # share of their speed; error that is none [rad]
_TRUTH = 5.0  # within which the simulator tells it [s]


@dataclass(frozen=True)
class Wanted:
    """What is to be done, by whom, and how time runs meanwhile."""

    task: str  # of ``TASKS``
    robot: str | None  # a name of ``robots/``, or a folder; None: the profile's
    actuators: str  # a profile of robot.yaml's
    seed: int
    real_time_factor: float
    video: Path | None  # where its film goes; None: none is made
    shut: bool = False  # whether what it is done to does not give


@dataclass(frozen=True)
class Done:
    """How it went; ``turned_deg`` is the fixture's, by the simulator."""

    task: str
    seed: int
    turned_deg: float
    moves: list[hand_motion.Moved]


def name(task: str) -> str:
    """Of a demonstration's own instance."""
    return f"demo-{task}"


def run(instance: Instance, wanted: Wanted, out: Path, progress: Progress, interruption: Interruption) -> None:
    """Do it, and tell how it went. Nothing goes on running behind it.

    Args:
        instance: of the demonstration's own.
        wanted: what, and by whom.
        out: the folder for what it leaves.
        progress: told how it goes on.
        interruption: ends it early.

    Raises:
        ValorError: the robot cannot, it was not done, or a part failed; says which.
    """
    demonstration.require_film(wanted.video)
    robot = RobotDescription.load(instance_setup.plan(Request(robot=wanted.robot)).settings.robot)
    plan = TASKS[wanted.task].plan(robot, wanted.seed)
    bag, report = demonstration.prepare(instance, out, f"{wanted.task}.mcap", f"{wanted.task}.json")
    world = TASKS[wanted.task].shut if wanted.shut else wanted.task
    request = Request(
        robot=wanted.robot, actuators=wanted.actuators, world=world, seed=wanted.seed,
        real_time_factor=wanted.real_time_factor, bag=bag,
    )  # fmt: skip
    failures = demonstration.Failures()
    with startup.running(instance, request, progress, interruption), failures.kept():
        done = _do(instance, wanted, plan, progress, interruption)
        report.write_text(json.dumps(asdict(done), indent=2) + "\n")
        _judge(done, progress)
    demonstration.tell([bag, report], progress)
    demonstration.film(bag, wanted.video, failures, progress)
    failures.tell()


def _do(instance: Instance, wanted: Wanted, plan: Plan, progress: Progress, interruption: Interruption) -> Done:
    check = interruption.check
    progress.waiting("walking up")
    outcome = stepping.step_to(instance, plan.stance, relative=False, check=check)
    if outcome.reason:
        raise ValorError(f"walking up: {outcome.reason}")
    progress.done(outcome.describe())
    control_mode.enter(instance, ControlMode.STAND_MANIPULATE, check)
    speed, tolerance = _FINGERS
    arm_motion.move_limb(instance, "right", "hand", plan.fingers, speed=speed, tolerance=tolerance, check=check)
    moves = hand_motion.lead(instance, plan, check, progress.waiting)
    with join(instance) as node:
        truth = hear(GROUND_TRUTH, GROUND_TRUTH.subscriber(node), _TRUTH)
    return Done(wanted.task, wanted.seed, math.degrees(float(truth.fixture_position[0])), moves)


def _judge(done: Done, progress: Progress) -> None:
    """Tell it, or raise if it is not enough."""
    task = TASKS[done.task]
    told = f"the {task.fixture} has been turned by {done.turned_deg:.0f}°"
    if done.turned_deg < math.degrees(task.enough):
        raise ValorError(f"{told}; expected at least {math.degrees(task.enough):.0f}°")
    progress.done(told)
