"""What several verbs take: their options, said once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from valor.common.instance import ClockMode
from valor.common.resources import profiles, robots
from valor.valorctl import completion

_ROBOT = typer.Option(help=f"{', '.join(robots())}, or a folder with robot.yaml.", autocompletion=completion.robots)
_PROFILE = typer.Option(
    help=f"Which processes, on what: {', '.join(profiles())}, or a .yaml file; sim unless given.",
    autocompletion=completion.profiles,
)
_CLOCK = typer.Option(help="How simulated time runs.")
_RTF = typer.Option(min=0.0, help="Real-time factor that lockstep is paced to; 0: as fast as it goes.")

Json = Annotated[bool, typer.Option("--json", help="As JSON.")]
Robot = Annotated[str, _ROBOT]
OptionalRobot = Annotated[str | None, _ROBOT]
Profile = Annotated[str, _PROFILE]
OptionalProfile = Annotated[str | None, _PROFILE]
Clock = Annotated[ClockMode, _CLOCK]
OptionalClock = Annotated[ClockMode | None, _CLOCK]
RealTimeFactor = Annotated[float, _RTF]
OptionalRealTimeFactor = Annotated[float | None, _RTF]
Video = Annotated[
    Path | None, typer.Option("--video", metavar="FILE", help="Film it: an .mp4, .webp or .gif, drawn when it is over.")
]
Topics = Annotated[
    list[str] | None, typer.Option(metavar="PATTERN", help="Only topics like '/joint_*'; may be repeated.")
]
AnyBag = Annotated[Path, typer.Argument(metavar="BAG", help="An .mcap or .db3 file, or a folder of them.")]
Deployment = Annotated[
    str | None,
    typer.Option(
        metavar="FILE",
        help="Several computers, and which process runs on which: a .yaml file (docs/deployment.md).",
        autocompletion=completion.deployments,
    ),
]
