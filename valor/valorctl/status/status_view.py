"""Terminal output of ``status`` and ``logs``. Green: ready; yellow: waiting or held; red: needs attention."""

import sys
import time
from collections.abc import Callable, Iterable
from datetime import date, datetime
from typing import NoReturn

from rich.console import Group
from rich.table import Table
from rich.text import Text

from valor.common.instance import Instance
from valor.common.linking import robot_side_advice
from valor.common.processes import BY_NAME
from valor.valorctl.drive.getting_up import BY_HAND, BY_ITSELF
from valor.valorctl.status.log_reader import SERVICES, LogLine
from valor.valorctl.status.status import WAY_OUT, Status
from valor.valorctl.terminal.console import rich_console, table

GOOD, WAITING, BAD, DIM = "green", "yellow", "bold red", "dim"
_STATES = {"ready": GOOD, "starting": WAITING, "degraded": WAITING, "stopped": DIM, "failed": BAD}

_HUES = ("cyan", "magenta", "blue", "bright_cyan", "bright_magenta", "bright_blue", "white", "bright_black")
_COLOURS = {name: _HUES[index % len(_HUES)] for index, name in enumerate(SERVICES)}
_SEVERE = {"warning": "yellow", "error": "red", "critical": "bold red"}
_WIDTH = max(map(len, SERVICES))


def view(status: Status) -> Group:
    """The state of an instance."""
    recording = [Text(status.recording.line())] if status.recording else []
    commands = [Text(refusal, WAITING)] if (refusal := status.settings.ros_refusal) else []
    page = [Text(f"page: {status.page}")] if status.page else []
    other_side = [Text(advice)] if (advice := robot_side_advice(status.settings)) else []
    return Group(
        *_heading(status),
        *commands,
        *_robot(status),
        _services(status),
        *_hosts(status),
        *recording,
        *page,
        *other_side,
    )


def show(look: Callable[[], Status], period: float) -> NoReturn:
    """Show the state again each period [s]: in place on a terminal, one below the other elsewhere."""
    if not sys.stdout.isatty():
        while True:
            rich_console().print(Group(view(look()), ""))
            time.sleep(period)
    from rich.live import Live

    with Live(view(look()), console=rich_console(wrap=True), auto_refresh=False) as live:
        while True:
            time.sleep(period)
            live.update(view(look()), refresh=True)


def _heading(status: Status) -> list[Text]:
    settings, clock = status.settings, status.clock
    heading = Text.assemble((status.instance, "bold"), f": {settings.robot.name}, profile {settings.profile}")
    if clock is None:
        return [heading.append(f", {settings.clock}")]
    ratio = f"{clock.mode}: {clock.real_time_factor:.2f} × real time in the last second"
    if status.factor_since_start is not None:
        ratio += f", {status.factor_since_start:.3f} since the start ({clock.slip:.2f} s lost)"
    return [heading.append(f", {clock.time * 1e-9:.1f} s of robot time"), Text(ratio)]


def _robot(status: Status) -> list[Text]:
    """Mode and behavior; if the robot needs a command, its reason, start, next command and recording."""
    behavior, condition = status.behavior or "?", status.condition
    colour = BAD if status.fallen else WAITING if behavior in WAY_OUT else "bold"
    lines = [
        Text.assemble(
            "control mode ", (status.control_mode or "?", "bold"),
            f", controller {status.controller}" if status.controller else "", ", behavior ", (behavior, colour),
            f" for {time.time() - condition.began:.0f} s" if condition else "",
        )
    ]  # fmt: skip
    if status.frozen:
        verb = f"valorctl mode freeze --joints none{Instance.option(status.instance)}"
        lines.append(Text.assemble((f"frozen: {', '.join(status.frozen)}", WAITING), " → ", (verb, "bold")))
    if status.paused:
        return [*lines, Text("robot time is paused", WAITING), Text.assemble("→ ", (status.way_out or "", "bold"))]
    if condition is None:
        return lines
    if status.way_out is None:
        return [lines[0].append(f": {condition.reason}"), *lines[1:]]
    word = "fallen" if status.fallen else behavior
    began = f"{datetime.fromtimestamp(condition.began):%H:%M:%S} ({condition.since:.1f} s of robot time)"
    lines.append(Text(f"{word} since {began}: {condition.reason}", colour))
    lines.append(Text.assemble("→ ", (status.way_out, "bold")))
    if status.fallen:
        lines.append(Text(f"  {BY_ITSELF}" if status.resettable else f"  otherwise: {BY_HAND}"))
        lines.append(
            Text(f"recorded in {condition.bag}" if condition.bag else "not recorded", "" if condition.bag else WAITING)
        )
    return lines


def _services(status: Status) -> Table:
    numbers = ("pid", "CPU %", "MiB", "restarts")
    shown = table("service", "state", *numbers, numbers=numbers)
    shown.add_column("", overflow="fold")
    for service in status.services:
        budget = BY_NAME[service.name]
        shown.add_row(
            service.name,
            Text(service.state, _STATES[service.state]),
            str(service.pid or "–"),
            _of(service.cpu_percent, budget.cpu_budget),
            _of(service.memory_mib, budget.memory_budget),
            Text(str(service.restarts), WAITING if service.restarts else ""),
            Text(service.detail),
        )
    return shown


def _hosts(status: Status) -> list[Table]:
    if not status.hosts:
        return []
    shown = table("host", "address", "processes")
    shown.add_column("", overflow="fold")
    for host in status.hosts:
        shown.add_row(host.name, host.address, ", ".join(host.processes) or "–", Text(host.problem, BAD))
    return [shown]


def _of(taken: float | None, budget: float) -> str:
    return f"{'–' if taken is None else f'{taken:.0f}'} of {budget:.0f}"


class LogView:
    """Printer of log lines, each process in its colour; ``named`` prefixes the process."""

    def __init__(self, named: bool) -> None:
        self._named = named
        self._console = rich_console()
        self._day = date.today()

    def show(self, lines: Iterable[LogLine]) -> None:
        """Print lines."""
        for line in lines:
            self._console.print(self._rendered(line))

    def _rendered(self, line: LogLine) -> Text:
        day = "" if line.when.date() == self._day else f"{line.when:%m-%d }"
        shown = f"{day}{line.when:%H:%M:%S}.{line.when.microsecond // 1000:03d} "
        text = Text(shown if line.begins else " " * len(shown), "dim")
        if self._named:
            text.append(f"{line.service:{_WIDTH}} ", _COLOURS[line.service])
        level = f"{line.level.upper()} " if line.begins and line.level != "info" else ""
        return text.append(level + line.text, _SEVERE.get(line.level, ""))
