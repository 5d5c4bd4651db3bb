"""``link bags``, ``link fetch``: the robot's bags, over the link."""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING, Annotated

import typer

from valor.common.instance import Instance
from valor.valorctl.amounts import size_text
from valor.valorctl.console import bar, rich_console, say, say_json, table
from valor.valorctl.interruption import Interruption
from valor.valorctl.verbs.options import Json

if TYPE_CHECKING:
    from valor.valorctl.fetching import Row


def register(app: typer.Typer) -> None:
    """Add the group."""
    group = typer.Typer(no_args_is_help=True, help="Over the link, from the operator's side: the robot's bags.")
    group.command()(bags)
    group.command()(fetch)
    app.add_typer(group, name="link")


def bags(json: Json = False) -> None:
    """List the robot's finished bags, as of the last window, and how those fare that were asked for."""
    from valor.valorctl.fetching import Listener

    with Interruption() as interruption:
        listener = Listener(Instance.from_environment(), interruption.check)
        with listener.ros:
            rows = listener.rows()
    if json:
        say_json([row.as_json() for row in rows])
    elif rows:
        _show(rows)
    else:
        say("no bags")


def _show(rows: list[Row]) -> None:
    shown = table("name", "when", "size", "here", "", numbers=("size", "here"))
    for row in rows:
        when = f"{datetime.fromtimestamp(row.begun):%Y-%m-%d %H:%M:%S}" if row.begun else ""
        size = size_text(row.size) if row.size >= 0 else ""
        shown.add_row(row.name, when, size, size_text(row.here), f"{row.said}{', kept' if row.kept else ''}")
    rich_console().print(shown)


def fetch(name: Annotated[str, typer.Argument(help="One of those that `link bags` shows.")]) -> None:
    """Have a bag come as the fast channel's windows allow; interrupted, it goes on coming."""
    from valor.valorctl.fetching import Listener, fetched

    instance = Instance.from_environment()
    with Interruption() as interruption:
        listener = Listener(instance, interruption.check)
        with listener.ros, bar(name, 100.0, "%") as tell:
            listener.fetch(name, lambda row: tell(100.0 * row.here / max(row.size, 1)))
    say(f"{fetched(instance, name)}")
