"""``calibrate arm``."""

from __future__ import annotations

from contextlib import nullcontext
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from valor.valorctl.terminal.console import Interruption, bar, progress, rich_console, say, say_json, say_rows, table
from valor.valorctl.terminal.options import Json

if TYPE_CHECKING:
    from valor.calibration.identify import Found
    from valor.robot.description import RobotDescription

calibrate = typer.Typer(
    name="calibrate", help="Identify parameters of a robot.", no_args_is_help=True, rich_markup_mode=None
)
FEWEST, USUAL = 3, 10  # poses


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.add_typer(calibrate)


@calibrate.callback()
def _calibrate() -> None:
    """Identify parameters of a robot."""


@calibrate.command()
def arm(
    side: Annotated[Literal["left", "right", "both"], typer.Argument(help="Arm to move.")] = "both",
    *,
    poses: Annotated[int, typer.Option(min=FEWEST, max=100, help="Number of poses of each arm.")] = USUAL,
    speed: Annotated[float, typer.Option(min=0.1, max=0.8, help="Share of the joint speed limits.")] = 0.5,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Print the result without writing it.")] = False,
    json: Json = False,
) -> None:
    """Move the arms and identify friction, backlash, servos and links; writes into the robot's folder."""
    from valor.common.table import plain
    from valor.robot import arm_calibration
    from valor.robot.description import RobotDescription
    from valor.valorctl.drive import arm_motion
    from valor.valorctl.drive.arm_calibrating import ArmCalibrating
    from valor.valorctl.instance import running

    groups = [f"{each}_arm" for each in arm_motion.SIDES if side in {each, "both"}]
    instance = running.require_running()
    robot = RobotDescription.load(instance.settings().robot)
    arm_motion.require_limbs(robot, "calibrate arm", *groups)
    if not dry_run:
        arm_calibration.require_writable(robot)
    with progress() as shown, Interruption() as interruption:
        found = ArmCalibrating(instance, robot, interruption, poses=poses, speed=speed).run(
            groups,
            shown.waiting if json else shown.stage,
            lambda whole: nullcontext(lambda _: None) if json else bar("moving", whole, "s", digits=0),
        )
    made = arm_calibration.joined(robot, {group: each.table for group, each in found.items()})
    file = robot.folder / arm_calibration.FILE
    if not dry_run:
        arm_calibration.write(robot, made)
    if json:
        residuals = {
            group: plain(each.table) | {"nominal_residual": each.nominal_residual} for group, each in found.items()
        }
        say_json({"file": None if dry_run else str(file), **residuals})
        return
    for group, each in found.items():
        _show(robot, group, each)
    if dry_run:
        say(f"{file} would be:\n{arm_calibration.text(made)}")
    else:
        say(f"{file} written; in effect from the next `valorctl up`")


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
    say_rows((name, f"{link.mass:.3f} kg, CoM {link.com} m") for name, link in found.table.links.items())
