"""``robot``: is a robot's folder sound, and does the robot do what every robot does."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from valor.common.resources import robot_folder, robots
from valor.valorctl import completion
from valor.valorctl.console import say

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
def check(named: Named) -> None:
    """Find what is wrong with a robot's folder."""
    from valor.valorctl.robot_check import require_sound

    require_sound(robot_folder(named))
    say(f"{named}: sound")


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


@robot.callback()
def _group() -> None:
    """A group, though it has one verb."""
