"""``demo``, ``demo walk``, ``demo door``, ``demo valve``."""

import os
from pathlib import Path
from typing import Annotated, Any

import typer

from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.valorctl.terminal.console import Interruption, progress
from valor.valorctl.terminal.options import Clock, OptionalRobot, RealTimeFactor

_OUT = Path("output/demo")
demo = typer.Typer(name="demo", invoke_without_command=True, rich_markup_mode=None)


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.add_typer(demo)


@demo.callback()
def reach_and_walk(
    context: typer.Context,
    out: Annotated[Path | None, typer.Option(help=f"Folder for the bag and the pictures; default {_OUT}.")] = None,
    robot: OptionalRobot = None,
    rtf: RealTimeFactor = 1.0,
) -> None:
    """Start a simulated robot, let it reach and walk onto the dirt, and shut it down; leaves a bag and pictures."""
    if context.invoked_subcommand is not None:
        if out is not None or robot is not None or rtf != 1.0:
            raise ValorError(f"options before `{context.invoked_subcommand}`: expected after it")
        return
    _run("demo", out or _OUT, {"robot": robot, "real_time_factor": rtf})


@demo.command()
def walk(
    *,
    out: Annotated[Path, typer.Option(help="Folder for the bag and the pictures.")] = Path("output/demo_walk"),
    robot: OptionalRobot = None,
    distance: Annotated[float | None, typer.Option(help="Distance [m]; default to the finish line.")] = None,
    speed: Annotated[float | None, typer.Option(help="Forward speed [m/s]; default by the robot's size.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the course and of the simulation's noise.")] = 0,
    clock: Clock = "lockstep",
    rtf: RealTimeFactor = 1.0,
) -> None:
    """Walk the 61 m course of uneven dirt; leaves a bag, metrics and pictures."""
    request = {"robot": robot, "seed": seed, "clock": clock, "real_time_factor": rtf}
    _run("demo-walk", out, request, distance=distance, speed=speed)


def _manipulate(name: str, description: str) -> None:
    def verb(
        *,
        out: Annotated[Path, typer.Option(help="Folder for the bag and the report.")] = Path(f"output/demo_{name}"),
        robot: OptionalRobot = None,
        actuators: Annotated[str, typer.Option(help="Actuator profile of robot.yaml.")] = "hardware",
        seed: Annotated[int, typer.Option(min=0, help="Seed of the fixture's position and of the noise.")] = 0,
        rtf: RealTimeFactor = 1.0,
        blocked: Annotated[
            bool, typer.Option("--blocked", help="The fixture does not move; the robot has to give up.")
        ] = False,
    ) -> None:
        request = {"robot": robot, "actuators": actuators, "seed": seed, "real_time_factor": rtf}
        _run(f"demo-{name}", out, request, blocked=blocked)

    demo.command(name, help=description)(verb)


_manipulate("door", "Walk up to a door, press its lever and push it open; leaves a bag and a report.")
_manipulate("valve", "Walk up to a valve and turn its wheel once; leaves a bag and a report.")


def _run(name: str, out: Path, request: dict[str, Any], **options: Any) -> None:
    """Run a demonstration in the named instance, or in one of its own; ``request``: see ``instance_setup.Request``."""
    from valor.valorctl.demos import demonstration
    from valor.valorctl.demos.demo_steps import DEMOS
    from valor.valorctl.instance.instance_setup import Request

    made = demonstration.DemoOptions(
        out.expanduser().absolute(), Request(**{"actuators": "hardware"} | request), **options
    )
    with progress() as shown, Interruption() as interruption:
        instance = Instance.from_environment(os.environ.get("VALOR_INSTANCE") or name)
        demonstration.run(instance, DEMOS[name], made, shown, interruption)
