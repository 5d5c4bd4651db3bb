"""``bag list``, ``bag keep``, ``bag prune``: the recordings of an instance, and which of them stay."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.valorctl.amounts import size_text, time_text
from valor.valorctl.console import rich_console, say, say_json, table
from valor.valorctl.recording_options import BOUND, BOUND_VARIABLE
from valor.valorctl.verbs.options import Json

if TYPE_CHECKING:
    from valor.valorctl.recording_list import Row


def register(bag: typer.Typer) -> None:
    """Add the verbs of ``bag`` that are about recordings as a whole."""
    bag.command("list")(list_recordings)
    bag.command()(keep)
    bag.command()(prune)


def list_recordings(
    everywhere: Annotated[bool, typer.Option("--all", help="Of every instance in VALOR_HOME.")] = False,
    json: Json = False,
) -> None:
    """List recordings, the oldest first: when, how long, how big, kept or being written, and what happened."""
    from valor.valorctl import recording_list

    rows = recording_list.rows(Instance.from_environment(), everywhere=everywhere)
    if json:
        say_json([row.as_json() for row in rows])
    elif rows:
        _show(rows)
    else:
        say("no recordings")


def _show(rows: list[Row]) -> None:
    shown = table("name", "when", "duration", "size", "", "instance", "events", numbers=("duration", "size"))
    for row in rows:
        marks = " ".join(word for word, yes in (("kept", row.kept), ("being written", row.written)) if yes)
        when = f"{datetime.fromtimestamp(row.begun):%Y-%m-%d %H:%M:%S}"
        duration = time_text(row.duration)
        shown.add_row(row.name, when, duration, size_text(row.size), marks, row.instance, "; ".join(row.events))
    rich_console().print(shown)
    say(f"{len(rows)} recordings, {size_text(sum(row.size for row in rows))}")


def keep(
    name: Annotated[str, typer.Argument(help="One of those that `bag list` shows, or its path.")],
    undo: Annotated[bool, typer.Option("--undo", help="Let it go again when it is the oldest.")] = False,
) -> None:
    """Mark a recording to stay, whatever the bounds."""
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
    say(f"{name} {'is bounded as all others' if undo else 'stays'}")


def prune(
    bound: Annotated[
        list[str] | None,
        typer.Option(
            BOUND,
            metavar="SIZE|AGE|SHARE",
            envvar=BOUND_VARIABLE,
            help="20GB, 30d, 10% of the disk; those of the last `up` unless given.",
        ),
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only say what would go.")] = False,
) -> None:
    """Remove the oldest recordings until the others are within bounds; as the recorder does while it records."""
    from valor.bags import recordings
    from valor.valorctl import recording_options

    bags = Instance.from_environment().bags
    bounds = recording_options.bounds(bound or (), recordings.saved_bounds(bags))
    try:
        gone = (recordings.too_many if dry_run else recordings.prune)(bags, bounds) if bags.is_dir() else []
    except OSError as error:
        raise ValorError(f"{error.filename or bags}: {error.strerror}") from None
    for each in gone:
        say(f"{each.piece.path.relative_to(bags)}: {size_text(each.piece.size)}, {each.why}")
    done = "would be freed" if dry_run else "freed"
    say(f"{size_text(sum(each.piece.size for each in gone))} {done}; {_left(bags)}")


def _left(bags: Path) -> str:
    from valor.bags import recordings

    return f"recordings take {size_text(sum(each.size for each in recordings.look(bags)))}"
