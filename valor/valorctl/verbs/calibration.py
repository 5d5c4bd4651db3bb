"""``calibrate arm``."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from valor.valorctl.console import bar, progress, rich_console, say, say_json, table
from valor.valorctl.interruption import Interruption
from valor.valorctl.verbs.options import Json

if TYPE_CHECKING:
    from valor.calibration.identify import Found
    from valor.robot.description import RobotDescription

calibrate = typer.Typer(
    name="calibrate", help="Find out what a robot's parts really are.", no_args_is_help=True, rich_markup_mode=None
)
FEWEST, USUAL = 3, 10  # poses


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.add_typer(calibrate)


@calibrate.callback()
def _calibrate() -> None:
    """Find out what a robot's parts really are."""  # with a callback, one verb alone is still named


@calibrate.command()
def arm(
    side: Annotated[Literal["left", "right", "both"], typer.Argument(help="Which arm.")] = "both",
    *,
    poses: Annotated[int, typer.Option(min=FEWEST, max=100, help="That each arm is brought through.")] = USUAL,
    speed: Annotated[float, typer.Option(min=0.1, max=0.8, help="Share of the joints' speed limits.")] = 0.5,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show what would be written, and write nothing.")] = False,
    plot: Annotated[
        Path | None, typer.Option("--plot", help="Draw what is left unexplained, before and after.")
    ] = None,
    json: Json = False,
) -> None:
    """Move a standing robot's arms, and find friction, play, servos and links; the robot's folder keeps it."""
    from valor.robot import arm_calibration
    from valor.robot.description import RobotDescription
    from valor.valorctl import arm_motion, presence
    from valor.valorctl.arm_calibrating import ArmCalibrating, Order

    groups = [f"{each}_arm" for each in arm_motion.SIDES if side in {each, "both"}]
    instance = presence.require_running()
    robot = RobotDescription.load(instance.settings().robot)
    arm_motion.require_limbs(robot, "calibrate arm", *groups)
    if not dry_run:
        arm_calibration.require_writable(robot)
    with progress() as shown, Interruption() as interruption:
        moving = ArmCalibrating(instance, robot, Order(poses, speed), interruption)
        found = moving.run(
            groups,
            shown.waiting if json else shown.stage,
            lambda whole: nullcontext(lambda _: None) if json else bar("moving", whole, "s", digits=0),
        )
    made = arm_calibration.joined(robot, {group: each.table for group, each in found.items()})
    file = robot.folder / arm_calibration.FILE
    if not dry_run:
        arm_calibration.write(robot, made)
    if plot is not None:
        _draw(robot, found, plot)
    if json:
        say_json(_plain(found, None if dry_run else str(file)))
        return
    for group, each in found.items():
        _show(robot, group, each)
    if plot is not None:
        say(f"picture: {plot}")
    if dry_run:
        say(f"{file} would be:\n{arm_calibration.text(made)}")
    else:
        say(f"{file} written; it counts from the next `valorctl up`")


def _show(robot: RobotDescription, group: str, found: Found) -> None:
    columns = ("friction", "damping", "(robot.yaml)", "play", "servo", "takes effort", "offset", "left", "(nominal)")
    units = ("[N·m]", "[N·m·s/rad]", "", "[mrad]", "[%]", "[%]", "[N·m]", "[N·m]", "")
    headings = [f"{name} {unit}".strip() for name, unit in zip(columns, units, strict=True)]
    shown = table(group, *headings, numbers=headings)
    for name, joint in found.table.joints.items():
        shown.add_row(
            name,
            f"{joint.friction:.2f}",
            f"{joint.damping:.2f}",
            f"{robot.tables.joints[name].damping:g}",
            "–" if joint.backlash is None else f"{1e3 * joint.backlash:.1f}",
            f"{100 * joint.strength:.0f}",
            f"{100 * joint.effort_share:.0f}",
            f"{joint.offset:+.2f}",
            f"{joint.residual:.2f}",
            f"{found.nominal_residual[name]:.2f}",
        )
    rich_console().print(shown)
    headings = ["mass [kg]", "(model.xml)", "CoM moved by [mm]"]
    shown = table("", *headings, numbers=headings)
    for name, link in found.table.links.items():
        nominal = found.nominal_links[name]
        moved = ", ".join(f"{1e3 * (one - other):+.1f}" for one, other in zip(link.com, nominal.com, strict=True))
        shown.add_row(name, f"{link.mass:.3f}", f"{nominal.mass:.3f}", moved)
    rich_console().print(shown)


def _plain(found: dict[str, Found], file: str | None) -> dict[str, object]:
    from valor.common.table import plain

    return {
        "file": file,
        **{
            group: plain(each.table)
            | {
                "nominal_residual": each.nominal_residual,
                "servo_residual": each.servo_residual,
                "nominal_links": {name: plain(link) for name, link in each.nominal_links.items()},
            }
            for group, each in found.items()
        },
    }


def _draw(robot: RobotDescription, found: dict[str, Found], file: Path) -> None:
    from valor.analysis import calibration_plot
    from valor.common.errors import ValorError

    panels = [
        calibration_plot.Panel(
            name,
            each.torques.velocity[moving, j],
            (each.torques.measured - each.torques.nominal)[moving, j],
            (each.torques.measured - each.torques.found)[moving, j],
        )
        for group, each in found.items()
        for j, name in enumerate(robot.tables.group(group))
        for moving in [each.torques.moving[:, j]]
    ]
    try:
        calibration_plot.draw(panels, file, f"{robot.name}: {sum(each.table.poses for each in found.values())} poses")
    except (OSError, ValueError) as error:
        raise ValorError(f"{file}: the picture cannot be written: {error}") from None
