"""``experiment``, ``report``."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valor.common.errors import ValorError, require_one_of
from valor.common.instance import Instance
from valor.valorctl.terminal import completion
from valor.valorctl.terminal.console import complain, progress, rich_console, say, table
from valor.valorctl.terminal.options import OptionalClock, Profile, Robot

if TYPE_CHECKING:
    from thesis.report.results import Result

INSTANCE = "experiment"
ALL = "all"
OUT = Path("output/experiments")
REPORT = "report"


@completion.completer
def _names(_: typer.Context) -> Iterable[str]:
    """Experiments, and all of them."""
    from thesis.experiments.table import BY_NAME

    return [*BY_NAME, ALL]


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.command()(experiment)
    app.command()(report)


def experiment(
    name: Annotated[
        str | None,
        typer.Argument(help="Which, or 'all'; they are listed unless given.", autocompletion=_names),
    ] = None,
    *,
    out: Annotated[Path, typer.Option(help="Each experiment leaves a folder of its name here.")] = OUT,
    quick: Annotated[bool, typer.Option("--quick", help="A short form, to see that everything works.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Of all that is random in the simulation.")] = 0,
    robot: Robot = "escher",
    actuators: Annotated[str, typer.Option(help="The robot's profile of imperfections: ideal, hardware.")] = "hardware",
    profile: Profile = "sim",
    clock: OptionalClock = None,
    with_clients: Annotated[
        bool,
        typer.Option(
            "--with-clients",
            help="process-stats: measure again, with the operator's page behind a link, a client and a planner.",
        ),
    ] = False,
) -> None:
    """Repeat an experiment of the thesis, or all and their report, in a system of its own."""
    from thesis.experiments.experiment import Options
    from thesis.experiments.table import BY_NAME, EXPERIMENTS, perform_all
    from valor.valorctl.terminal.console import Interruption

    if name is None:
        listed = table("experiment", "title", "reproduces")
        for each in EXPERIMENTS:
            listed.add_row(each.name, each.title, each.reproduces)
        listed.add_row(ALL, "One after the other, and their report", "")
        rich_console().print(listed)
        return
    require_one_of("experiment", name, (*BY_NAME, ALL))
    if with_clients and name not in (ALL, "process-stats"):
        raise ValorError(f"experiment {name}: --with-clients applies only to process-stats and {ALL}")
    folder = out.expanduser().absolute()
    instance = Instance.from_environment(os.environ.get("VALOR_INSTANCE") or INSTANCE)
    out = folder if name == ALL else folder / name
    options = Options(out, quick, seed, actuators, robot, profile, clock, with_clients)
    with progress() as shown, Interruption() as interruption:
        if name != ALL:
            result, file = BY_NAME[name].perform(instance, options, shown, interruption)
            _show(result)
            shown.done(str(file))
            return
        perform_all(instance, options, shown, interruption, _show)
        _report(folder, folder / REPORT)


def report(
    folder: Annotated[Path, typer.Argument(help="Where the experiments left their folders.")] = OUT,
    *,
    out: Annotated[Path | None, typer.Option(help="The report's folder; FOLDER/report unless given.")] = None,
) -> None:
    """Gather the results of experiments, each number beside the thesis', in an HTML page and Markdown with figures."""
    folder = folder.expanduser().absolute()
    _report(folder, (out or folder / REPORT).expanduser().absolute())


def _report(folder: Path, out: Path) -> None:
    """Write the report of the results found; then list what is missing or broken."""
    from thesis.experiments.table import EXPERIMENTS
    from thesis.report import chapters, page

    found = chapters.collect(folder, EXPERIMENTS)
    files = page.write(found, out)
    for file in files:
        say(f"{file} ({file.stat().st_size / 1e6:.1f} MB)")
    say(f"{sum(chapter.result is not None for chapter in found)} of {len(found)} experiments are in it")
    if missing := [chapter.name for chapter in found if chapter.result is None and not chapter.broken]:
        say(f"not run: {', '.join(missing)}")
    broken = [line for chapter in found for line in chapter.broken]
    for line in broken:
        complain(line)
    if broken:
        raise ValorError("the report is written; its chapters name these faults")


def _show(result: Result) -> None:
    title = f"{result.title} ({result.reproduces})"
    shown = table("", "here", "unit", "thesis", numbers=("here", "thesis"), title=title, title_justify="left")
    for measure in result.measures:
        value = "–" if measure.value is None else f"{measure.value:.4g}"
        shown.add_row(measure.name, value, measure.unit, measure.thesis)
    rich_console().print(shown)
