"""``robot``: is a robot's folder sound, and does the robot do what every robot does."""

from __future__ import annotations

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


@robot.callback()
def _group() -> None:
    """A group, though it has one verb."""
