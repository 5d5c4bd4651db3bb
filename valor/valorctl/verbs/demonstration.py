"""``demo``, ``demo walk``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.valorctl.console import progress
from valor.valorctl.verbs.options import Clock, OptionalRobot, RealTimeFactor

_OUT = Path("output/demo")

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
) -> None:
    """Let the robot stand up, reach out and walk onto the dirt in a system of its own; leaves a bag and pictures."""
    if context.invoked_subcommand is not None:
        if out is not None or robot is not None or rtf != 1.0:
            raise ValorError(f"options of `demo {context.invoked_subcommand}` are expected behind it")
        return
    from valor.valorctl import reach_and_walk as demonstration
    from valor.valorctl.interruption import Interruption

    with progress() as shown, Interruption() as interruption:
        instance, folder = _instance(demonstration.NAME), (out or _OUT).expanduser().absolute()
        demonstration.run(instance, demonstration.Wanted(robot, rtf), folder, shown, interruption)


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
) -> None:
    """Walk the 61 m course of uneven dirt; leaves a bag, figures and pictures."""
    from valor.valorctl import demonstration, walk_demonstration
    from valor.valorctl.interruption import Interruption

    course = walk_demonstration.Course(
        robot=robot,
        distance=demonstration.course() if distance is None else distance,
        speed=demonstration.SPEED if speed is None else speed,
        seed=seed,
        clock=clock,
        real_time_factor=rtf,
    )
    with progress() as shown, Interruption() as interruption:
        instance = _instance(walk_demonstration.NAME)
        walk_demonstration.run(instance, course, out.expanduser().absolute(), shown, interruption)


def _instance(name: str) -> Instance:
    """Of the demonstration's own, unless another is named."""
    return Instance.from_environment(os.environ.get("VALOR_INSTANCE") or name)
