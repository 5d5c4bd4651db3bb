"""``robot``: is a robot's folder sound, and does the robot do what every robot does."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
import typer

from valor.common.errors import ValorError
from valor.common.resources import robot_folder, robots
from valor.valorctl import completion
from valor.valorctl.console import progress, rich_console, say, say_json, table
from valor.valorctl.interruption import Interruption
from valor.valorctl.verbs.options import Json

if TYPE_CHECKING:
    from rich.table import Table

    from valor.valorctl.robot_play import Rung

robot = typer.Typer(name="robot", help="Make, check and show robots.", no_args_is_help=True, rich_markup_mode=None)

Named = Annotated[
    str,
    typer.Argument(
        metavar="ROBOT", help=f"{', '.join(robots())}, or a folder with robot.yaml.", autocompletion=completion.robots
    ),
]


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.add_typer(robot)


@robot.command()
def check(
    named: Named,
    no_play: Annotated[bool, typer.Option("--no-play", help="Look at the folder alone.")] = False,
    json: Json = False,
) -> None:
    """Find what is wrong with a robot's folder; then play it: it stands, reaches, is pushed, steps and walks."""
    from valor.valorctl import robot_check, robot_play

    folder = robot_folder(named)
    findings = robot_check.examine(folder)
    notes = robot_check.notes(findings)
    rungs: list[robot_play.Rung] = []
    if not (no_play or findings.faults):
        with progress() as shown, Interruption() as interruption:
            rungs = robot_play.play(folder, interruption.check, shown.waiting)
    if json:
        say_json(
            {
                "robot": str(folder),
                "faults": [str(fault) for fault in findings.faults],
                "unchecked": findings.unchecked,
                "notes": notes,
                "rungs": msgspec.to_builtins(rungs),
            }
        )
    findings.require_none()
    if not json:
        say(f"{named}: nothing wrong with its folder")
        for line in notes:
            say(f"  {line}")
        if rungs:
            rich_console().print(_rungs(rungs))
    if failed := [f"{rung.name} ({rung.profile})" for rung in rungs if not rung.passed]:
        raise ValorError(f"{named}: {len(failed)} of {len(rungs)} rungs failed: {', '.join(failed)}")


def _rungs(rungs: list[Rung]) -> Table:
    """What was played, a line each."""
    from rich.markup import escape

    numbers = ("tilt [°]", r"DCM \[mm]", r"way \[m]", "knee [°]", "no QP")
    shown = table("actuators", "rung", "", *numbers, "torque at its limit", "", numbers=numbers)
    for rung in rungs:
        seen, cells = rung.numbers, ["–"] * len(numbers)
        most = ""
        if seen is not None:
            error, knee = seen.dcm_error, seen.knee_margin
            cells = [
                f"{math.degrees(seen.tilt):.1f}",
                "–" if error is None else f"{error * 1e3:.0f}",
                f"{seen.distance:.2f}",
                "–" if knee is None else f"{math.degrees(knee):.0f}",
                str(seen.unsolved),
            ]
            worst = sorted(seen.at_limit.items(), key=lambda each: -each[1])[:1]
            most = "".join(f"{name} {share:.1%}" for name, share in worst)
        verdict = "[green]ok[/]" if rung.passed else "[red]failed[/]"
        shown.add_row(rung.profile, rung.name, verdict, *cells, most, escape(rung.reason or rung.told))
    return shown


@robot.command()
def new(
    model: Annotated[Path, typer.Argument(metavar="MODEL", help="MJCF or URDF; it stays as it is.")],
    *,
    name: Annotated[str | None, typer.Option(help="Of the robot; asked for unless given.")] = None,
    out: Annotated[Path | None, typer.Option(help="The robot's folder; one of its name, here, unless given.")] = None,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Ask nothing: take the guesses.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace a robot's folder that is there.")] = False,
) -> None:
    """Make a robot's folder of its model; what cannot be found out there is asked."""
    from valor.valorctl import robot_making

    robot_making.make(model, name, out, guess=yes, replace=force)


@robot.command()
def show(
    named: Named,
    *,
    out: Annotated[Path | None, typer.Option(help="The picture, .png; NAME.png, here, unless given.")] = None,
) -> None:
    """Draw a robot: joints' axes, soles, shapes that touch, centre of mass, and how far its joints go."""
    from valor.analysis import robot_picture
    from valor.robot.description import RobotDescription

    described = RobotDescription.load(robot_folder(named))
    say(str(robot_picture.draw(described, out or Path(f"{described.name}.png"))))


@robot.command()
def moveit(
    named: Named,
    *,
    out: Annotated[Path | None, typer.Option(help="The package; NAME_moveit_config, here, unless given.")] = None,
    namespace: Annotated[str, typer.Option(metavar="NAME", help="In which the robot is up; none unless given.")] = "",
    force: Annotated[bool, typer.Option("--force", help="Replace a configuration that is there.")] = False,
) -> None:
    """Make a robot's MoveIt configuration, a ROS package: SRDF, limits, controllers, kinematics, URDF and meshes."""
    from valor.valorctl import moveit_package, robot_check

    moveit_package.make(robot_check.require_sound(robot_folder(named)), out, namespace=namespace, replace=force)


@robot.callback()
def _group() -> None:
    """A group, though it has one verb."""
