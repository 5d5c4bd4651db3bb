"""``demo``, ``demo walk``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from valor.common.instance import ClockMode, Instance
from valor.valorctl.console import progress

demo = typer.Typer(name="demo", invoke_without_command=True, rich_markup_mode=None)


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.add_typer(demo)


@demo.callback()
def reach(
    context: typer.Context,
    out: Annotated[Path, typer.Option(help="The folder for the bag and the pictures.")] = Path("output/demo"),
    robot: Annotated[str | None, typer.Option(help="A name of robots/, or a folder.")] = None,
) -> None:
    """Let the robot stand up and reach out in a system of its own; leaves a bag and pictures."""
    if context.invoked_subcommand is not None:
        return
    from valor.valorctl import demonstration
    from valor.valorctl.interruption import Interruption

    with progress() as shown, Interruption() as interruption:
        demonstration.run(_instance(demonstration.NAME), robot, out.expanduser().absolute(), shown, interruption)


@demo.command()
def walk(
    *,
    out: Annotated[Path, typer.Option(help="The folder for the bag and the pictures.")] = Path("output/demo_walk"),
    distance: Annotated[float | None, typer.Option(help="To the finish line unless given [m].")] = None,
    speed: Annotated[float | None, typer.Option(help="Forward [m/s].")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the course and of all that is random in the simulation.")] = 0,
    clock: Annotated[ClockMode, typer.Option(help="How simulated time runs.")] = "lockstep",
    rtf: Annotated[
        float, typer.Option(min=0.0, help="Real-time factor that lockstep is paced to; 0: as fast as it goes.")
    ] = 1.0,
) -> None:
    """Walk the 61 m course of uneven dirt; leaves a bag, figures and pictures."""
    from valor.valorctl import walk_demonstration
    from valor.valorctl.interruption import Interruption

    course = walk_demonstration.Course(
        distance=walk_demonstration.course() if distance is None else distance,
        speed=walk_demonstration.SPEED if speed is None else speed,
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
