"""``bag`` and ``video``: manage, show, repair, convert and film recordings; mark a moment, save the last seconds."""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer

from valor.common.errors import ConfigurationError, ValorError
from valor.common.instance import Instance
from valor.common.resources import robot_folder
from valor.valorctl.recordings.recording_options import BOUND, BOUND_VARIABLE
from valor.valorctl.terminal.console import (
    Interruption,
    bar,
    complain,
    progress,
    rich_console,
    say,
    say_json,
    size_text,
    table,
    time_text,
)
from valor.valorctl.terminal.options import AnyBag, Json, OptionalRobot, Topics

SNAP_TIMEOUT = 60.0  # the recorder writes many messages [s]
bag = typer.Typer(name="bag", help="Manage and read recordings.", no_args_is_help=True, rich_markup_mode=None)


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.add_typer(bag)
    app.command()(video)


@bag.command("list")
def list_recordings(
    everywhere: Annotated[bool, typer.Option("--all", help="List those of every instance in VALOR_HOME.")] = False,
    json: Json = False,
) -> None:
    """List recordings, the oldest first. Show start, duration, size, marks and events."""
    from valor.valorctl.recordings.bag_summary import rows

    found = rows(Instance.from_environment(), everywhere=everywhere)
    if json:
        say_json([asdict(row) for row in found])
        return
    if not found:
        say("no recordings")
        return
    shown = table("name", "start", "duration", "size", "", "instance", "events", numbers=("duration", "size"))
    for row in found:
        marks = " ".join(word for word, yes in (("kept", row.kept), ("being written", row.written)) if yes)
        when = f"{datetime.fromtimestamp(row.begun):%Y-%m-%d %H:%M:%S}"
        duration = time_text(row.duration)
        shown.add_row(row.name, when, duration, size_text(row.size), marks, row.instance, "; ".join(row.events))
    rich_console().print(shown)
    say(f"{len(found)} recordings, {size_text(sum(row.size for row in found))}")


@bag.command()
def info(
    file: Annotated[
        Path, typer.Argument(metavar="BAG", help="An .mcap file, a folder of them, or a name from `bag list`.")
    ],
    json: Json = False,
) -> None:
    """Show the contents of a bag. For every topic, show type and number of messages."""
    from valor.valorctl.recordings.bag_summary import summarize

    named = Instance.from_environment().bags / file
    found = summarize(named if not file.exists() and named.exists() else file)
    if json:
        say_json(found.as_json())
        return
    when = f"{datetime.fromtimestamp(found.start):%Y-%m-%d %H:%M:%S}" if found.messages else "empty"
    say(f"{found.file}: {when}, {found.duration:.1f} s, {size_text(found.size)}, {found.messages} messages")
    shown = table("topic", "type", "messages", "Hz", numbers=("messages", "Hz"))
    for topic in found.topics:
        shown.add_row(topic.name, topic.type, str(topic.messages), f"{topic.rate:.1f}")
    rich_console().print(shown)


@bag.command()
def keep(
    name: Annotated[str, typer.Argument(help="A name from `bag list`, or a path in the recording.")],
    undo: Annotated[bool, typer.Option("--undo", help="Remove the mark.")] = False,
) -> None:
    """Exempt a recording from the bounds."""
    from valor.bags import recordings

    instance = Instance.from_environment()
    found = {each.name: each for each in recordings.look(instance.bags)}
    path = Path(name).resolve()
    name = next((each for each in found if (instance.bags / each).resolve() in (path, *path.parents)), name)
    if name not in found:
        raise ValorError(f"{name}: no recording in {instance.bags}; `valorctl bag list` shows them")
    try:
        recordings.keep(found[name], not undo)
    except OSError as error:
        raise ValorError(f"{error.filename}: {error.strerror}") from None
    say(f"{name} {'is subject to the bounds again' if undo else 'is kept'}")


@bag.command()
def prune(
    bound: Annotated[
        list[str] | None,
        typer.Option(
            BOUND,
            metavar="SIZE|AGE|SHARE",
            envvar=BOUND_VARIABLE,
            help="Bound of all recordings: 20GB, 30d, 10% of the disk. [default: those of the last `up`]",
        ),
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only show what would be removed.")] = False,
) -> None:
    """Remove the oldest recordings beyond the bounds."""
    from valor.bags import recordings, retention
    from valor.valorctl.recordings import recording_options

    bags = Instance.from_environment().bags
    bounds = recording_options.bounds(bound or (), retention.saved_bounds(bags))
    try:
        removed = (retention.too_many if dry_run else retention.prune)(bags, bounds) if bags.is_dir() else []
    except OSError as error:
        raise ValorError(f"{error.filename or bags}: {error.strerror}") from None
    for each in removed:
        say(f"{each.piece.path.relative_to(bags)}: {size_text(each.piece.size)}, {each.why}")
    freed = f"{size_text(sum(each.piece.size for each in removed))} {'would be freed' if dry_run else 'freed'}"
    say(f"{freed}; recordings take {size_text(sum(each.size for each in recordings.look(bags)))}")


@bag.command()
def snap(json: Json = False) -> None:
    """Save the last seconds. The recorder must hold them (`up --bag-ring`)."""
    from valor.common.messages import SnapRequest
    from valor.common.topics import SNAP
    from valor.valorctl.drive.node import request
    from valor.valorctl.instance import running

    instance, needs = running.require_running(), "the recorder does not run"
    reply = request(instance, SNAP, SnapRequest(), timeout=SNAP_TIMEOUT, action="snap", needs=needs)
    if json:
        say_json({"file": reply.path, "messages": reply.messages, "seconds": reply.seconds})
    else:
        say(f"{reply.path}: {reply.seconds:.1f} s, {reply.messages} messages")


@bag.command()
def mark(text: Annotated[str, typer.Argument(help="Description of the moment, one line.")]) -> None:
    """Mark the current moment as an event of the recording."""
    from valor.common.messages import MarkRequest
    from valor.common.topics import MARK
    from valor.valorctl.drive.node import request
    from valor.valorctl.instance import running

    instance, needs = running.require_running(), "the recorder does not run"
    reply = request(instance, MARK, MarkRequest(text), timeout=2.0, action="mark", needs=needs)
    say(f"marked at {datetime.fromtimestamp(reply.stamp * 1e-9):%H:%M:%S.%f}")


@bag.command()
def recover(file: Annotated[Path, typer.Argument(help="An .mcap file.")]) -> None:
    """Finish the bag of a killed recorder. Work in place; leave a finished bag unchanged."""
    from valor.bags import rosbag2_metadata
    from valor.bags.files import is_own_folder
    from valor.bags.recovery import recover as finish

    found = finish(file)
    if is_own_folder(file.absolute()):
        rosbag2_metadata.write(file.absolute().parent)
    if found.finished:
        say(f"{file}: complete, {found.messages} messages")
    else:
        say(f"{file}: finished, {found.messages} messages kept, {found.bytes_cut} bytes cut")


@bag.command()
def csv(
    bag_path: AnyBag,
    out: Annotated[Path | None, typer.Option(help="A new folder. [default: BAG_csv]")] = None,
    topic: Topics = None,
    json: Json = False,
) -> None:
    """Write a ROS 2 bag as CSV, one file per topic. Of a damaged bag, write what is readable, and fail."""
    from valor.analysis.reading.csv_export import export

    folder = out or bag_path.with_name(f"{bag_path.stem}_csv")
    with progress() as shown, Interruption() as interruption:

        def report(messages: int) -> None:
            interruption.check()
            shown.waiting(f"{messages} messages")

        made = export(bag_path, folder, topic or (), report)
    damage, messages = made.condition.damage, made.condition.messages
    if json:
        files = {str(file): rows for file, rows in made.files.items()}
        say_json({"files": files, "notices": made.notices, "damage": damage, "messages": messages})
    else:
        for line in made.notices:
            say(line)
        say(f"{folder}: {len(made.files)} topics, {sum(made.files.values())} messages")
    if topic and not made.files:
        raise ValorError(
            f"{bag_path}: no topic matches {', '.join(topic)}; `valorctl bag info {bag_path}` lists the topics"
        )
    for line in damage:
        complain(line)
    if damage:
        raise ValorError(f"{bag_path}: damaged; {messages} messages are readable")


def video(
    bag_path: AnyBag,
    *,
    begin: Annotated[float, typer.Option("--from", help="Start, since the start of the recording [s].")] = 0.0,
    end: Annotated[float | None, typer.Option("--to", help="End, since then [s]; default its end.")] = None,
    camera: Annotated[
        str, typer.Option(help="follow, front, back, left, right, above, feet, hands, shoulder, or fixed.")
    ] = "follow",
    speed: Annotated[float, typer.Option(help="Playback speed; 0.2 is slow motion.")] = 1.0,
    overlay: Annotated[
        str, typer.Option(help="forces, dcm (with CoM, CoP, support), modes; separated by commas.")
    ] = "",
    out: Annotated[Path | None, typer.Option(help="File, .mp4 or .webp; default BAG's name with .mp4.")] = None,
    size: Annotated[
        str | None, typer.Option(metavar="WxH", help="Size [pixels]; default 1280x720, .webp 640x360.")
    ] = None,
    fps: Annotated[float | None, typer.Option(help="Pictures per second; default 25, .webp 12.5.")] = None,
    robot: OptionalRobot = None,
    json: Json = False,
) -> None:
    """Draw a film of a recording: the robot in its world, at its true pose if known, else as estimated."""
    from valor.analysis.film import film

    overlays = tuple(filter(None, (each.strip() for each in overlay.split(","))))
    folder = robot_folder(robot) if robot else None
    options = film.FilmOptions(begin, end, camera, speed, overlays, _size(size), fps, folder)
    file = out or bag_path.with_name(f"{bag_path.stem}.mp4")
    with ExitStack() as stack:
        shown, interruption = stack.enter_context(progress()), stack.enter_context(Interruption())
        fill: list[Callable[[float], None]] = []

        def read(seconds: float) -> None:
            interruption.check()
            shown.waiting(f"reading: {seconds:.0f} s")

        def drawn(pictures: int, total: int) -> None:
            interruption.check()
            if not (fill or json):
                shown.clear()
                fill.append(stack.enter_context(bar("drawing", total, "pictures", digits=0)))
            for show in fill:
                show(pictures)

        made = film.make(bag_path, file, options, read, drawn)
    for line in made.notices:
        complain(line)
    size_made = made.file.stat().st_size
    if json:
        counts = {"pictures": made.pictures, "duration_s": made.duration, "bytes": size_made}
        say_json({"file": str(made.file), **counts, "base": made.base})
    else:
        say(f"{made.file}: {made.duration:.1f} s, {size_text(size_made)}; base pose: {made.base}")


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise ConfigurationError(f"size {text!r}: expected WxH, as 1280x720 [pixels]")
    return int(width), int(height)
