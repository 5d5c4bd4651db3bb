"""``video``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from valor.common.errors import ConfigurationError
from valor.common.resources import robot_folder
from valor.valorctl.console import say_json
from valor.valorctl.verbs.options import AnyBag, Json, OptionalRobot


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command()(video)


def video(
    bag_path: AnyBag,
    *,
    begin: Annotated[float, typer.Option("--from", help="After the recording's beginning [s].")] = 0.0,
    end: Annotated[float | None, typer.Option("--to", help="Likewise; to its end unless given [s].")] = None,
    camera: Annotated[
        str, typer.Option(help="follow, front, back, left, right, above, feet, hands; fixed does not go along.")
    ] = "follow",
    speed: Annotated[float, typer.Option(help="Times the robot's own; 0.2 is slow motion.")] = 1.0,
    overlay: Annotated[
        str, typer.Option(help="forces, dcm (with CoM, CoP, support), modes; several with commas between.")
    ] = "",
    out: Annotated[Path | None, typer.Option(help="An .mp4, .webp or .gif; BAG's name with .mp4 unless given.")] = None,
    size: Annotated[
        str | None, typer.Option(metavar="WxH", help="1280x720, .webp 640x360, .gif 480x270 unless given [pixels].")
    ] = None,
    fps: Annotated[float | None, typer.Option(help="Pictures a second; 25, .webp and .gif 12.5 unless given.")] = None,
    fine: Annotated[
        bool, typer.Option("--fine", help="Finer edges and shadows; takes some four times as long.")
    ] = False,
    robot: OptionalRobot = None,
    json: Json = False,
) -> None:
    """Draw a film of a recording, off screen: the robot in its world, as the simulator or its estimate had it."""
    from valor.analysis.film import film
    from valor.valorctl import filming

    overlays = tuple(filter(None, (each.strip() for each in overlay.split(","))))
    order = film.Order(
        begin, end, camera, speed, overlays, _size(size), fps, robot_folder(robot) if robot else None, fine
    )
    made = filming.shoot(bag_path, out or bag_path.with_name(f"{bag_path.stem}.mp4"), order, quiet=json)
    if json:
        say_json(
            {
                "file": str(made.file),
                "pictures": made.pictures,
                "duration_s": made.duration,
                "bytes": made.file.stat().st_size,
                "base": made.base,
            }
        )


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise ConfigurationError(f"size {text!r}: expected WxH, as 1280x720 [pixels]")
    return int(width), int(height)
