"""``status``, ``view``, ``logs``, ``env``."""

from __future__ import annotations

import time
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valor.common import linking
from valor.common.errors import ConfigurationError
from valor.common.instance import Instance
from valor.common.viewing import LOOPBACK
from valor.valorctl import completion
from valor.valorctl.console import complain, say, say_json
from valor.valorctl.verbs.options import OptionalRobot

if TYPE_CHECKING:
    from valor.valorctl.hosts.beyond import BeyondLogs
    from valor.valorctl.hosts.logs import HostsLogs
    from valor.valorctl.log_reader import LogReader
    from valor.valorctl.watch import Watch

WATCH_PERIOD = 1.0  # [s]


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.command()(status)
    app.command()(view)
    app.command()(logs)
    app.command()(env)


def status(
    watch: Annotated[bool, typer.Option("--watch", "-w", help="Look again every second, until interrupted.")] = False,
    json: Annotated[bool, typer.Option("--json", help="As JSON; with --watch an object a line.")] = False,
) -> None:
    """Show how every process fares, what the robot does and why, and how time runs."""
    from valor.valorctl import watch as looking

    instance = Instance.from_environment()
    if watch:
        _watch(looking.Watch(instance), json)
    else:
        looking.run(instance, json)


def view(
    bag: Annotated[
        Path | None, typer.Option(metavar="BAG", help="Show a recording: an .mcap or .db3 file, or a folder of them.")
    ] = None,
    robot: OptionalRobot = None,
    host: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Of this computer, to be reached there by TLS with a token.")
    ] = LOOPBACK,
    certificate: Annotated[
        Path | None, typer.Option(metavar="FILE", help="PEM, certificate and key; a self-made one unless given.")
    ] = None,
) -> None:
    """Serve a page on which a robot is seen and driven, or a recording played, until interrupted."""
    from valor.valorctl import viewing
    from valor.valorctl.interruption import InterruptedBySignalError, Interruption

    if robot is not None and bag is None:
        raise ConfigurationError("--robot: expected with --bag, of a recording that does not name its robot")
    if bag is not None and (host != LOOPBACK or certificate is not None):
        raise ConfigurationError("--bag: a recording is shown on this computer alone; expected it without --host")
    with Interruption() as interruption:
        try:
            if bag is not None:
                viewing.show_recording(bag, robot, interruption.check)
            else:
                viewing.serve(Instance.from_environment(), viewing.place(host, certificate), interruption.check, say)
        except InterruptedBySignalError:
            say("the page is served no longer" + ("" if bag else "; the robot does what it did"))


def _watch(watch: Watch, json: bool) -> None:
    from valor.valorctl.interruption import until_interrupted
    from valor.valorctl.status_view import show

    with watch, until_interrupted():
        if json:
            while True:
                say_json(watch.look().as_json(), one_line=True)
                time.sleep(WATCH_PERIOD)
        show(watch.look, WATCH_PERIOD)


def logs(
    service: Annotated[
        str | None,
        typer.Argument(
            help="One of those that `status` lists, or supervisord; all unless given.",
            autocompletion=completion.services,
        ),
    ] = None,
    lines: Annotated[
        int | None, typer.Option("--lines", "-n", min=0, help="How many of the last lines; 20 unless --since is given.")
    ] = None,
    since: Annotated[
        str | None, typer.Option(metavar="TIME", help="What is not older: 30s, 5min, 2h, 14:05, '2026-01-31 14:05'.")
    ] = None,
    level: Annotated[
        str,
        typer.Option(help="What is as grave: debug, info, warning, error, critical.", autocompletion=completion.levels),
    ] = "",
    follow: Annotated[bool, typer.Option("--follow", "-f", help="Go on with what comes, until interrupted.")] = False,
) -> None:
    """Show what the processes print, in the order of time; also after `down`."""
    from valor.valorctl.interruption import until_interrupted
    from valor.valorctl.log_reader import LogReader, moment
    from valor.valorctl.log_view import LogView

    begin = moment(since, datetime.now()) if since is not None else None
    count = 20 if lines is None and since is None else lines
    instance = Instance.from_environment()
    reading: type[LogReader | HostsLogs | BeyondLogs] = LogReader
    settings = instance.settings() if instance.settings_file.exists() else None
    if settings is not None and service is not None and linking.beyond(settings, service):
        from valor.valorctl.hosts.beyond import BeyondLogs

        reading = BeyondLogs
    elif settings is not None and settings.hosts:
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
    """Print what another shell or program joins the instance with: eval "$(valorctl env)"."""
    from valor.valorctl.environment import exports

    say(exports(Instance.from_environment()))
