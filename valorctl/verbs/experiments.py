"""``experiment``, ``report``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valor_common.errors import ValorError
from valor_common.instance import Instance
from valorctl.console import progress, rich_console, say

if TYPE_CHECKING:
    from valor_analysis.results import Result

INSTANCE = "experiment"


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.command()(experiment)
    app.command()(report)


def experiment(
    name: Annotated[str | None, typer.Argument(help="Which; all are listed unless given.")] = None,
    *,
    out: Annotated[Path, typer.Option(help="Each experiment leaves a folder of its name here.")] = Path(
        "output/experiments"
    ),
    quick: Annotated[bool, typer.Option("--quick", help="A short form, to see that everything works.")] = False,
    seed: Annotated[int, typer.Option(help="Of all that is random in the simulation.")] = 0,
    robot: Annotated[str, typer.Option(help="A name of robots/, or a folder.")] = "escher",
    actuators: Annotated[str, typer.Option(help="The robot's profile of imperfections: ideal, hardware.")] = "hardware",
) -> None:
    """Repeat an experiment of the thesis in a system of its own; leaves figures, CSV and a result."""
    from valorctl.experiments.experiment import Options
    from valorctl.experiments.table import BY_NAME, EXPERIMENTS
    from valorctl.interruption import Interruption

    if name is None:
        from rich.table import Table

        table = Table(box=None, pad_edge=False, header_style="dim")
        for column in ("experiment", "title", "reproduces"):
            table.add_column(column)
        for each in EXPERIMENTS:
            table.add_row(each.name, each.title, each.reproduces)
        rich_console().print(table)
        return
    if name not in BY_NAME:
        raise ValorError(f"experiment {name!r}: expected one of {', '.join(BY_NAME)}")
    options = Options(out.expanduser().absolute() / name, quick, seed, actuators, robot)
    instance = Instance.from_environment(os.environ.get("VALOR_INSTANCE") or INSTANCE)
    with progress() as shown, Interruption() as interruption:
        result, file = BY_NAME[name].perform(instance, options, shown, interruption)
        _show(result)
        shown.done(str(file))


def report(
    folder: Annotated[Path, typer.Argument(help="Where the experiments left their folders.")] = Path(
        "output/experiments"
    ),
    *,
    out: Annotated[Path | None, typer.Option(help="The page; FOLDER/report.html unless given.")] = None,
    pdf: Annotated[bool, typer.Option("--pdf", help="And the same as a PDF beside the page.")] = False,
) -> None:
    """Gather the results of experiments into one page, each number beside the thesis'."""
    from valor_analysis import report as page
    from valorctl.experiments.table import BY_NAME

    results = page.collect(folder.expanduser().absolute(), tuple(BY_NAME))
    file = page.write(results, (out or folder / "report.html").expanduser().absolute())
    say(f"{file}: {len(results)} experiments ({file.stat().st_size / 1e6:.1f} MB)")
    if pdf:
        from valor_analysis import report_pdf

        paper = report_pdf.write(results, file.with_suffix(".pdf"))
        say(f"{paper} ({paper.stat().st_size / 1e6:.1f} MB)")
    if missing := set(BY_NAME) - {result.experiment for result, _ in results}:
        say(f"not there: {', '.join(name for name in BY_NAME if name in missing)}")


def _show(result: Result) -> None:
    from rich.table import Table

    table = Table(title=f"{result.title} ({result.reproduces})", box=None, pad_edge=False, header_style="dim",
                  title_justify="left")  # fmt: skip
    table.add_column("")
    table.add_column("here", justify="right")
    table.add_column("unit")
    table.add_column("thesis", justify="right")
    for measure in result.measures:
        value = "–" if measure.value is None else f"{measure.value:.4g}"
        table.add_row(measure.name, value, measure.unit, measure.thesis)
    rich_console().print(table)
