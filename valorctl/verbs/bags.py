"""``bag``: what a recording holds, mending one that was cut short, saving the last seconds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from valor_common.instance import Instance
from valorctl.console import rich_console, say, say_json

bag = typer.Typer(name="bag", help="Look into recordings, and mend them.", no_args_is_help=True)

File = Annotated[Path, typer.Argument(help="An .mcap file.")]


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.add_typer(bag)


@bag.command()
def info(file: File, json: Annotated[bool, typer.Option("--json", help="As JSON.")] = False) -> None:
    """Show when it was recorded, and every topic with its type and number of messages."""
    from valorctl.bag_summary import summarize

    summary = summarize(file)
    if json:
        say_json(summary.as_json())
        return
    from rich.table import Table

    console = rich_console()
    console.print(
        f"{summary.file}: {summary.size / 1e6:.1f} MB, {summary.duration:.1f} s, {summary.messages} messages",
        markup=False,
    )
    table = Table(box=None, pad_edge=False, header_style="dim")
    table.add_column("topic")
    table.add_column("type")
    table.add_column("messages", justify="right")
    table.add_column("Hz", justify="right")
    for topic in summary.topics:
        table.add_row(topic.name, topic.type, str(topic.messages), f"{topic.rate:.1f}")
    console.print(table)


@bag.command()
def snap(json: Annotated[bool, typer.Option("--json", help="As JSON.")] = False) -> None:
    """Save the last seconds, of a recorder that holds them (up --bag-ring)."""
    from valorctl import bag_snap, status

    instance = Instance.from_environment()
    status.require_up(instance)
    reply = bag_snap.snap(instance)
    if json:
        say_json({"file": reply.path, "messages": reply.messages, "seconds": reply.seconds})
    else:
        say(f"{reply.path}: {reply.seconds:.1f} s, {reply.messages} messages")


@bag.command()
def recover(file: File) -> None:
    """Finish in place a recording whose recorder was killed; one that is whole is left alone."""
    from valor_common.bag_recovery import recover as finish

    found = finish(file)
    if found.finished:
        say(f"{file}: whole, {found.messages} messages")
    else:
        say(f"{file}: finished, {found.messages} messages kept, {found.bytes_cut} bytes cut")
