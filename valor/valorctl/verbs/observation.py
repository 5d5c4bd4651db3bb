"""``status``, ``logs``, ``env``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from valor.common.instance import Instance
from valor.valorctl import completion
from valor.valorctl.console import rich_console, say, say_json

if TYPE_CHECKING:
    from valor.valorctl.status import Status

_COLOURS = {"ready": "green", "starting": "yellow", "degraded": "yellow", "stopped": "dim", "failed": "bold red"}


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.command()(status)
    app.command()(logs)
    app.command()(env)


def status(json: Annotated[bool, typer.Option("--json", help="As JSON.")] = False) -> None:
    """Show how every process fares, what the robot does, and how time runs."""
    from valor.valorctl.status import look

    seen = look(Instance.from_environment())
    if json:
        say_json(seen.as_json())
    else:
        _show(seen)


def _show(status: Status) -> None:
    from rich.table import Table

    settings, clock = status.settings, status.clock
    time = clock.mode if clock else settings.clock
    if clock:
        time += f", {clock.real_time_factor:.2f} × real time in the last second"
        if status.factor_since_start is not None:
            time += f", {status.factor_since_start:.3f} since the start ({clock.slip:.2f} s lost)"
    console = rich_console()
    console.print(
        f"[bold]{status.instance}[/]: {settings.robot.name}, profile {settings.profile}, {time}\n"
        f"control mode [bold]{status.control_mode or '?'}[/], behavior [bold]{status.behavior or '?'}[/]"
    )
    table = Table(box=None, pad_edge=False, header_style="dim")
    table.add_column("service")
    table.add_column("state")
    for name in ("pid", "CPU %", "MiB", "restarts"):
        table.add_column(name, justify="right")
    table.add_column("")
    for service in status.services:
        table.add_row(
            service.name,
            f"[{_COLOURS[service.state]}]{service.state}[/]",
            str(service.pid or "–"),
            "–" if service.cpu_percent is None else f"{service.cpu_percent:.0f}",
            "–" if service.memory_mib is None else f"{service.memory_mib:.0f}",
            str(service.restarts),
            service.detail,
        )
    console.print(table)
    if status.recording is not None:
        say(status.recording.line())


def logs(
    service: Annotated[
        str | None,
        typer.Argument(help="One of those that `status` lists; all unless given.", autocompletion=completion.services),
    ] = None,
    lines: Annotated[int, typer.Option("--lines", "-n", min=0, help="How many of the last lines.")] = 20,
    follow: Annotated[bool, typer.Option("--follow", "-f", help="Go on with what comes.")] = False,
) -> None:
    """Show what the processes print; also after `down`."""
    from valor.valorctl.log_reader import LogReader

    with LogReader(Instance.from_environment(), service) as reader:
        for line in reader.last(lines):
            say(line)
        while follow:
            for line in reader.wait():
                say(line)


def env() -> None:
    """Print what another shell or program joins the instance with: eval "$(valorctl env)"."""
    from valor.valorctl.environment import exports

    say(exports(Instance.from_environment()))
