"""``trace``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valor.common.instance import Instance
from valor.valorctl.console import bar, rich_console, say, say_json, table
from valor.valorctl.interruption import Interruption
from valor.valorctl.verbs.options import Json

if TYPE_CHECKING:
    from valor.valorctl.tracing import Tracing

_SHOWN = 8  # of the ranking
_THREADS = 12


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command()(trace)


def trace(
    seconds: Annotated[float, typer.Option("--for", min=0.1, max=120.0, help="How long to listen [s].")] = 5.0,
    plot: Annotated[Path, typer.Option("--plot", help="The picture.")] = Path("trace.png"),
    json: Json = False,
) -> None:
    """Follow a control period through all processes: what it consists of, and who makes the world wait."""
    from valor.analysis import period_plot
    from valor.valorctl.tracing import trace as run

    instance = Instance.from_environment()
    with Interruption() as interruption:
        if json:
            seen = run(instance, seconds, interruption.check, lambda _: None)
        else:
            with bar("tracing", seconds, "s") as tell:
                seen = run(instance, seconds, interruption.check, tell)
    period_plot.draw(seen.periods, seen.ranking, plot)
    if json:
        say_json(seen.as_json() | {"picture": str(plot)})
    else:
        _show(seen)
        say(f"picture: {plot}")


def _show(seen: Tracing) -> None:
    import numpy as np

    console, periods = rich_console(), seen.periods
    console.print(periods.describe() + "\n")
    durations = ("median [ms]", "99 %", "max", "without a core, mean")
    parts = table("part of a period", *durations, numbers=durations)
    for title, lasted, idle in [
        ("whole period", periods.length, None),
        *((s.title, s.duration, s.without_core) for s in periods.segments),
    ]:
        median, p99, longest = np.percentile(lasted, (50, 99, 100)) * 1e3
        parts.add_row(title, f"{median:.3f}", f"{p99:.3f}", f"{longest:.2f}",
                      "" if idle is None else f"{1e3 * idle.mean():.3f}")  # fmt: skip
    console.print(parts, "")
    if seen.ranking:
        columns = ("who made the world wait", "why", "delay [ms]", "periods", "meanwhile at work")
        ranking = table(*columns, numbers=("delay [ms]", "periods"))
        for blame in seen.ranking[:_SHOWN]:
            beside = ", ".join(f"{name} {100 * share:.0f} %" for name, share in blame.beside.items())
            ranking.add_row(blame.title, blame.cause, f"{1e3 * blame.delay:.1f}", str(blame.periods), beside)
        console.print(ranking, "")
    amounts = ("runs [%]", "waits for a core [%]", "turns [1/s]")
    threads = table("thread", "process", *amounts, numbers=amounts)
    for use in seen.threads[:_THREADS]:
        threads.add_row(use.name, use.process, f"{use.running:.1f}", f"{use.waiting:.1f}", f"{use.turns:.0f}")
    console.print(threads)
    cost = ", ".join(f"{name} {percent:.1f}" for name, percent in seen.cost.items())
    console.print(f"\nbeing traced took, of a core [%]: {cost}")
