"""Options that several verbs share."""

from pathlib import Path
from typing import Annotated

import typer

from valor.common.instance import ClockMode
from valor.common.resources import names, robots
from valor.valorctl.terminal import completion

_ROBOT = typer.Option(
    help=f"Robot: {', '.join(robots())}, or a folder with robot.yaml.", autocompletion=completion.robots
)
_PROFILE = typer.Option(
    help=f"Processes and their backend: {', '.join(names('profile'))}, or a .yaml file. [default: sim]",
    autocompletion=completion.profiles,
)
_CLOCK = typer.Option(help="Source of simulated time.")
_RTF = typer.Option(min=0.0, help="Real-time factor of lockstep; 0: unlimited.")

Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]
Robot = Annotated[str, _ROBOT]
OptionalRobot = Annotated[str | None, _ROBOT]
Profile = Annotated[str, _PROFILE]
OptionalProfile = Annotated[str | None, _PROFILE]
Clock = Annotated[ClockMode, _CLOCK]
OptionalClock = Annotated[ClockMode | None, _CLOCK]
RealTimeFactor = Annotated[float, _RTF]
OptionalRealTimeFactor = Annotated[float | None, _RTF]
Topics = Annotated[list[str] | None, typer.Option(metavar="PATTERN", help="Only topics like '/joint_*'; repeatable.")]
AnyBag = Annotated[Path, typer.Argument(metavar="BAG", help="An .mcap file, or a folder of them.")]
Deployment = Annotated[
    str | None,
    typer.Option(
        metavar="FILE",
        help="Computers, and the processes on each: a .yaml file (docs/deployment.md).",
        autocompletion=completion.deployments,
    ),
]
