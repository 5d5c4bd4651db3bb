"""``bag``: what a recording holds, mending, saving the last seconds, CSV, playing."""

from __future__ import annotations

from contextlib import nullcontext
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.valorctl.console import bar, complain, progress, rich_console, say, say_json, table
from valor.valorctl.interruption import Interruption
from valor.valorctl.verbs import recordings
from valor.valorctl.verbs.options import AnyBag, Json, Topics

if TYPE_CHECKING:
    from valor.valorctl.bag_summary import BagSummary

bag = typer.Typer(name="bag", help="Look into recordings and repair them.", no_args_is_help=True, rich_markup_mode=None)

File = Annotated[Path, typer.Argument(help="An .mcap file.")]


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    recordings.register(bag)
    app.add_typer(bag)


@bag.command()
def info(
    file: Annotated[
        Path, typer.Argument(metavar="BAG", help="An .mcap file, a folder of them, a folder of recordings, or a name.")
    ],
    json: Json = False,
) -> None:
    """Show when it was recorded, and every topic with its type and number of messages; of several, a line each."""
    from valor.valorctl.bag_summary import find, summarize

    named = Instance.from_environment().bags / file
    found = find(named if not file.exists() and named.exists() else file)
    if len(found) > 1:
        _summarize_each(found, json)
        return
    summary = summarize(found[0])
    if json:
        say_json(summary.as_json())
        return
    say(_at_a_glance(summary))
    shown = table("topic", "type", "messages", "Hz", numbers=("messages", "Hz"))
    for topic in summary.topics:
        shown.add_row(topic.name, topic.type, str(topic.messages), f"{topic.rate:.1f}")
    rich_console().print(shown)


def _summarize_each(found: list[Path], as_json: bool) -> None:
    """Those that can be read; of the others why not, which is no error: one may be being written."""
    from valor.valorctl.bag_summary import summarize

    objects = []
    for path in found:
        try:
            summary = summarize(path)
        except ValorError as error:
            complain(str(error))
            continue
        objects.append(summary.as_json())
        if not as_json:
            say(_at_a_glance(summary))
    if as_json:
        say_json(objects)


def _at_a_glance(summary: BagSummary) -> str:
    return f"{summary.file}: {summary.size / 1e6:.1f} MB, {summary.duration:.1f} s, {summary.messages} messages"


@bag.command()
def snap(json: Json = False) -> None:
    """Save the last seconds, of a recorder that holds them (up --bag-ring)."""
    from valor.valorctl import presence, requests

    reply = requests.snap(presence.require_running())
    if json:
        say_json({"file": reply.path, "messages": reply.messages, "seconds": reply.seconds})
    else:
        say(f"{reply.path}: {reply.seconds:.1f} s, {reply.messages} messages")


@bag.command()
def mark(text: Annotated[str, typer.Argument(help="A line.")]) -> None:
    """Note this moment in the recording, as an event of its metadata."""
    from valor.valorctl import presence, requests

    reply = requests.mark(presence.require_running(), text)
    say(f"marked at {datetime.fromtimestamp(reply.stamp * 1e-9):%H:%M:%S.%f}")


@bag.command()
def recover(file: File) -> None:
    """Finish in place a recording whose recorder was killed; one that is whole is left alone."""
    from valor.bags import rosbag2_metadata
    from valor.bags.files import is_own_folder
    from valor.bags.recovery import recover as finish

    found = finish(file)
    if is_own_folder(file.absolute()):
        rosbag2_metadata.write(file.absolute().parent)
    if found.finished:
        say(f"{file}: whole, {found.messages} messages")
    else:
        say(f"{file}: finished, {found.messages} messages kept, {found.bytes_cut} bytes cut")


@bag.command()
def csv(
    bag_path: AnyBag,
    out: Annotated[Path | None, typer.Option(help="A new folder; BAG's name with _csv unless given.")] = None,
    topic: Topics = None,
    parquet: Annotated[bool, typer.Option("--parquet", help="As Parquet files; needs pyarrow.")] = False,
    json: Json = False,
) -> None:
    """Write any ROS 2 bag as CSV, one file a topic; of a damaged one what can be saved, and then fail."""
    from valor.analysis.csv_export import export

    folder = out or bag_path.with_name(f"{bag_path.stem}_csv")
    total = 0 if json else _messages(bag_path)
    with (
        progress() as shown,
        bar("writing", total, "messages", digits=0) if total else nullcontext() as fill,
        Interruption() as interruption,
    ):

        def tell(messages: int) -> None:
            interruption.check()
            if fill:
                fill(messages)
            else:
                shown.waiting(f"{messages} messages")

        made = export(bag_path, folder, topic or (), tell, as_parquet=parquet)
    if json:
        say_json(
            {
                "files": {str(file): rows for file, rows in made.files.items()},
                "notices": made.notices,
                "damage": made.condition.damage,
                "messages": made.condition.messages,
            }
        )
    else:
        for line in made.notices:
            say(line)
        say(f"{folder}: {len(made.files)} topics, {sum(made.files.values())} messages")
    _fail_if_nothing(bag_path, topic, len(made.files))
    _fail_if_damaged(bag_path, made.condition.damage, made.condition.messages)


@bag.command()
def play(
    bag_path: AnyBag,
    rate: Annotated[float, typer.Option(help="Of the bag's own pace.")] = 1.0,
    topic: Topics = None,
    domain: Annotated[int | None, typer.Option(min=0, max=232, help="ROS domain; ROS_DOMAIN_ID unless given.")] = None,
) -> None:
    """Publish a bag's messages on ROS topics; never into the domain of a running system."""
    from valor.valorctl import bag_player

    instance = Instance.from_environment()
    with progress() as shown, Interruption() as interruption:
        played = bag_player.play(
            bag_path,
            instance,
            domain=domain,
            rate=rate,
            topics=topic or (),
            check=interruption.check,
            tell=lambda passed, messages: shown.waiting(f"{passed:.1f} s, {messages} messages"),
        )
    for name, reason in played.skipped.items():
        say(f"left out: {name}: {reason}")
    say(f"played {played.messages} messages")
    _fail_if_nothing(bag_path, topic, played.messages + len(played.skipped))
    _fail_if_damaged(bag_path, played.damage, played.messages)


def _messages(bag_path: Path) -> int:
    """How many a bag holds, if its index says so."""
    from valor.valorctl.bag_summary import summarize

    try:
        return summarize(bag_path).messages
    except ValorError:  # of another kind, or damaged
        return 0


def _fail_if_nothing(bag_path: Path, topics: list[str] | None, found: int) -> None:
    if topics and not found:
        raise ValorError(f"{bag_path}: no topic is like {', '.join(topics)}; `valorctl bag info` lists them")


def _fail_if_damaged(bag_path: Path, damage: list[str], messages: int) -> None:
    for line in damage:
        complain(line)
    if damage:
        raise ValorError(f"{bag_path}: damaged; {messages} messages of it could be read")
