"""``demo``, ``demo walk``, ``demo door``, ``demo valve``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.valorctl.console import progress
from valor.valorctl.verbs.options import Clock, OptionalRobot, RealTimeFactor, Video

if TYPE_CHECKING:
    from valor.valorctl.task_demonstration import Wanted

_OUT = Path("output/demo")
Seed = Annotated[int, typer.Option(min=0, help="Of where it stands, and of all that is random in the simulation.")]
Actuators = Annotated[str, typer.Option(help="A profile of robot.yaml's actuators.")]

demo = typer.Typer(name="demo", invoke_without_command=True, rich_markup_mode=None)


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.add_typer(demo)


@demo.callback()
def reach_and_walk(
    context: typer.Context,
    out: Annotated[Path | None, typer.Option(help=f"The folder for the bag and the pictures; else {_OUT}.")] = None,
    robot: OptionalRobot = None,
    rtf: RealTimeFactor = 1.0,
    video: Video = None,
) -> None:
    """Let the robot stand up, reach out and walk onto the dirt in a system of its own; leaves a bag and pictures."""
    if context.invoked_subcommand is not None:
        if out is not None or robot is not None or rtf != 1.0 or video is not None:
            raise ValorError(f"options of `demo {context.invoked_subcommand}` are expected behind it")
        return
    from valor.valorctl import reach_and_walk as demonstration
    from valor.valorctl.interruption import Interruption

    with progress() as shown, Interruption() as interruption:
        instance, folder = _instance(demonstration.NAME), (out or _OUT).expanduser().absolute()
        demonstration.run(instance, demonstration.Wanted(robot, rtf, video), folder, shown, interruption)


@demo.command()
def walk(
    *,
    out: Annotated[Path, typer.Option(help="The folder for the bag and the pictures.")] = Path("output/demo_walk"),
    robot: OptionalRobot = None,
    distance: Annotated[float | None, typer.Option(help="To the finish line unless given [m].")] = None,
    speed: Annotated[float | None, typer.Option(help="Forward [m/s].")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the course and of all that is random in the simulation.")] = 0,
    clock: Clock = "lockstep",
    rtf: RealTimeFactor = 1.0,
    video: Video = None,
) -> None:
    """Walk the 61 m course of uneven dirt; leaves a bag, figures and pictures."""
    from valor.valorctl import demonstration, walk_demonstration
    from valor.valorctl.interruption import Interruption

    course = walk_demonstration.Course(
        robot=robot,
        distance=demonstration.course() if distance is None else distance,
        speed=speed,
        seed=seed,
        clock=clock,
        real_time_factor=rtf,
        video=video,
    )
    with progress() as shown, Interruption() as interruption:
        instance = _instance(walk_demonstration.NAME)
        walk_demonstration.run(instance, course, out.expanduser().absolute(), shown, interruption)


@demo.command()
def door(
    *,
    out: Annotated[Path, typer.Option(help="The folder for the bag and the report.")] = Path("output/demo_door"),
    robot: OptionalRobot = None,
    actuators: Actuators = "hardware",
    seed: Seed = 0,
    rtf: RealTimeFactor = 1.0,
    video: Video = None,
    shut: Annotated[bool, typer.Option("--shut", help="It does not give, and is to be left alone.")] = False,
) -> None:
    """Walk up to a door, press its lever and push it open; leaves a bag and a report."""
    from valor.valorctl.task_demonstration import Wanted

    _task(Wanted("door", robot, actuators, seed, rtf, video, shut), out)


@demo.command()
def valve(
    *,
    out: Annotated[Path, typer.Option(help="The folder for the bag and the report.")] = Path("output/demo_valve"),
    robot: OptionalRobot = None,
    actuators: Actuators = "hardware",
    seed: Seed = 0,
    rtf: RealTimeFactor = 1.0,
    video: Video = None,
    stuck: Annotated[bool, typer.Option("--stuck", help="It does not turn, and is to be left alone.")] = False,
) -> None:
    """Walk up to a valve and turn its wheel once; leaves a bag and a report."""
    from valor.valorctl.task_demonstration import Wanted

    _task(Wanted("valve", robot, actuators, seed, rtf, video, stuck), out)


def _task(wanted: Wanted, out: Path) -> None:
    from valor.valorctl import task_demonstration
    from valor.valorctl.interruption import Interruption

    with progress() as shown, Interruption() as interruption:
        instance = _instance(task_demonstration.name(wanted.task))
        task_demonstration.run(instance, wanted, out.expanduser().absolute(), shown, interruption)


def _instance(name: str) -> Instance:
    """Of the demonstration's own, unless another is named."""
    return Instance.from_environment(os.environ.get("VALOR_INSTANCE") or name)
