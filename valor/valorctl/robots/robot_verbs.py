"""``robot new``, ``robot get-up``, ``robot check``, ``robot show``, ``robot moveit``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
import typer

from valor.common.errors import ConfigurationError, ValorError
from valor.common.resources import robot_folder, robots
from valor.valorctl.terminal import completion
from valor.valorctl.terminal.console import Interruption, progress, rich_console, say, say_json, table
from valor.valorctl.terminal.options import Json

if TYPE_CHECKING:
    from rich.table import Table

    from valor.self_test.results import AcceptanceResult

robot = typer.Typer(
    name="robot", help="Make, check, draw and export robots' folders.", no_args_is_help=True, rich_markup_mode=None
)

Named = Annotated[
    str,
    typer.Argument(
        metavar="ROBOT", help=f"{', '.join(robots())}, or a folder with robot.yaml.", autocompletion=completion.robots
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Replace an existing folder.")]


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.add_typer(robot)


@robot.command()
def check(
    named: Named,
    no_play: Annotated[bool, typer.Option("--no-play", help="Check the folder only.")] = False,
    json: Json = False,
) -> None:
    """Check a robot's folder, then simulate the robot: stand, reach, pushes, steps and a walk."""
    from valor.valorctl.robots import robot_check

    folder = robot_folder(named)
    findings = robot_check.examine(folder)
    notes = findings.notes()
    results: list[AcceptanceResult] = []
    if not (no_play or findings.faults):
        with progress() as shown, Interruption() as interruption:
            results = robot_check.run(folder, interruption.check, shown.waiting)
    if json:
        say_json(
            {
                "robot": str(folder),
                "faults": [str(fault) for fault in findings.faults],
                "unchecked": findings.unchecked,
                "notes": notes,
                "rungs": msgspec.to_builtins(results),
            }
        )
    findings.require_none()
    if not json:
        say(f"{named}: no faults in the folder")
        for line in notes:
            say(f"  {line}")
        if results:
            rich_console().print(results_table(results))
    if failed := [f"{result.name} ({result.profile})" for result in results if not result.passed]:
        raise ValorError(f"{named}: {len(failed)} of {len(results)} tests failed: {', '.join(failed)}")


def results_table(results: list[AcceptanceResult]) -> Table:
    """Table of acceptance tests."""
    from rich.markup import escape

    numbers = ("tilt [°]", r"DCM \[mm]", r"distance \[m]", "knee [°]", "no QP")
    shown = table("actuators", "test", "", *numbers, "torque at its limit", "", numbers=numbers)
    for result in results:
        seen, cells = result.numbers, ["–"] * len(numbers)
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
        verdict = "[green]ok[/]" if result.passed else "[red]failed[/]"
        shown.add_row(result.profile, result.name, verdict, *cells, most, escape(result.reason or result.told))
    return shown


@robot.command()
def new(
    model: Annotated[Path, typer.Argument(metavar="MODEL", help="MJCF or URDF file; not changed.")],
    *,
    name: Annotated[str | None, typer.Option(help="Name of the robot; asked for by default.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of the robot; default ./NAME.")] = None,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Accept all guesses instead of asking.")] = False,
    force: Force = False,
) -> None:
    """Make a robot's folder from its model; asks for what the model does not determine."""
    from valor.valorctl.robots import robot_making

    robot_making.make(model, name, out, guess=yes, replace=force)


@robot.command("get-up")
def get_up(
    named: Named, force: Annotated[bool, typer.Option("--force", help="Replace an existing get_up.yaml.")] = False
) -> None:
    """Search for the motions by which the robot gets up, in simulation, up to half an hour; writes get_up.yaml."""
    from valor.get_up_planning.plan import plan
    from valor.robot.description import RobotDescription
    from valor.robot.get_up_table import FILE

    folder = robot_folder(named)
    file = folder / FILE
    if file.exists() and not force:
        raise ConfigurationError(f"{file}: exists; expected a robot without, or --force to replace it")
    with progress() as shown, Interruption() as interruption:

        def report(stage: str) -> None:
            interruption.check()
            shown.stage(stage)

        content = plan(RobotDescription.load(folder), report)
    file.write_text(content)
    say(f"{file}: written")


@robot.command()
def show(
    named: Named,
    *,
    out: Annotated[Path | None, typer.Option(help="Picture, .png; default ./NAME.png.")] = None,
) -> None:
    """Draw a robot: joint axes and ranges, soles, collision shapes, centre of mass."""
    from valor.analysis.robot import robot_picture
    from valor.robot.description import RobotDescription

    described = RobotDescription.load(robot_folder(named))
    say(str(robot_picture.draw(described, out or Path(f"{described.name}.png"))))
