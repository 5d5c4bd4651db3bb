"""``status``, ``view``, ``logs``, ``env``, ``doctor``."""

from __future__ import annotations

import shlex
import time
from dataclasses import asdict
from datetime import datetime
from typing import TYPE_CHECKING, Annotated

import typer

from valor.common import linking
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.valorctl.terminal import completion
from valor.valorctl.terminal.console import (
    InterruptedBySignalError,
    Interruption,
    complain,
    progress,
    rich_console,
    say,
    say_json,
    until_interrupted,
)
from valor.valorctl.terminal.options import Deployment, Json

if TYPE_CHECKING:
    from valor.valorctl.hosts.logs import HostsLogs
    from valor.valorctl.status.log_reader import LogReader

WATCH_PERIOD = 1.0  # [s]
_COLOURS = {"ok": "green", "warn": "yellow", "fail": "bold red"}


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.command()(status)
    app.command()(view)
    app.command()(logs)
    app.command()(env)
    app.command()(doctor)


def status(
    watch: Annotated[bool, typer.Option("--watch", "-w", help="Repeat every second until interrupted.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON; with --watch, one object per line.")] = False,
) -> None:
    """Show processes, robot, robot time and recording."""
    from valor.valorctl.instance.running import unsupervised
    from valor.valorctl.status.status import Watch

    instance = Instance.from_environment()
    with Watch(instance) as source:
        if watch and json:
            with until_interrupted():
                while True:
                    say_json(source.look().as_json(), one_line=True)
                    time.sleep(WATCH_PERIOD)
        elif watch:
            from valor.valorctl.status.status_view import show

            with until_interrupted():
                show(source.look, WATCH_PERIOD)
        seen = source.look()
    if json:
        say_json(seen.as_json())
    else:
        from valor.valorctl.status.status_view import view

        rich_console().print(view(seen))
    if not seen.supervised:
        raise ValorError(unsupervised(instance, len(seen.services)))


def view() -> None:
    """Serve the operator's page until interrupted."""
    from valor.valorctl.instance import viewing

    with Interruption() as interruption:
        try:
            viewing.serve(Instance.from_environment(), interruption.check, say)
        except InterruptedBySignalError:
            say("the page is not served any more; the robot is unaffected")


def logs(
    service: Annotated[
        str | None,
        typer.Argument(
            help="A process listed by `status`, or supervisord. [default: all]", autocompletion=completion.services
        ),
    ] = None,
    lines: Annotated[
        int | None, typer.Option("--lines", "-n", min=0, help="Number of last lines. [default: 20 without --since]")
    ] = None,
    since: Annotated[
        str | None, typer.Option(metavar="TIME", help="Earliest time: 30s, 5min, 2h, 14:05, '2026-01-31 14:05'.")
    ] = None,
    level: Annotated[
        str,
        typer.Option(help="Least level: debug, info, warning, error, critical.", autocompletion=completion.levels),
    ] = "",
    follow: Annotated[bool, typer.Option("--follow", "-f", help="Print new lines until interrupted.")] = False,
) -> None:
    """Show the merged logs of the processes. Works also after `down`."""
    from valor.valorctl.status.log_reader import LogReader, moment
    from valor.valorctl.status.status_view import LogView

    begin = moment(since, datetime.now()) if since is not None else None
    count = 20 if lines is None and since is None else lines
    instance = Instance.from_environment()
    reading: type[LogReader | HostsLogs] = LogReader
    settings = instance.settings() if instance.settings_file.exists() else None
    if settings is not None and service is not None:
        linking.require_local(settings, service, "logs")
    if settings is not None and settings.hosts:
        from valor.valorctl.hosts.logs import HostsLogs

        reading = HostsLogs
    with reading(instance, service, begin, level.lower(), count) as reader:
        view = LogView(named=service is None)
        found = reader.take()
        view.show(found if count is None else found[max(0, len(found) - count) :])
        for problem in reader.problems:
            complain(problem)
        with until_interrupted():
            while follow:
                view.show(reader.wait())


def env() -> None:
    """Print the environment of the instance. Join it by: eval "$(valorctl env)"."""
    say(exports(Instance.from_environment()))


def exports(instance: Instance) -> str:
    """The environment of an instance as shell commands; raises ``ConfigurationError`` if it is not up."""
    return "\n".join(f"export {name}={shlex.quote(value)}" for name, value in instance.environment().items())


def doctor(json: Json = False, deployment: Deployment = None) -> None:
    """Find known problems of computer and instance. Suggest remedies; with several hosts, check all."""
    from valor.valorctl.instance.checks import run_all

    instance = Instance.from_environment()
    with progress() as shown:
        if deployment is not None or (instance.settings_file.exists() and instance.settings().hosts):
            from valor.valorctl.hosts import multi_host

            findings = multi_host.diagnose(instance, deployment, shown.waiting)
        else:
            findings = run_all(instance, shown.waiting)
    if json:
        say_json([asdict(finding) for finding in findings])
    else:
        console = rich_console()
        for finding in findings:
            console.print(f"[{_COLOURS[finding.level]}]{finding.level:4}[/] {finding.check:10} ", end="")
            console.print(f"{finding.host}: {finding.text}" if finding.host else finding.text, markup=False)
            if finding.advice:
                console.print(f"{'':16}→ {finding.advice}", markup=False)
    if any(finding.level == "fail" for finding in findings):
        raise typer.Exit(1)
