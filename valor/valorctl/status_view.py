"""What a person sees of an instance: green is well, yellow is on its way or held, red wants somebody."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from datetime import datetime
from typing import NoReturn

from rich.console import Group
from rich.table import Table
from rich.text import Text

from valor.common.processes import BY_NAME
from valor.valorctl.console import rich_console, table
from valor.valorctl.status import WAY_OUT, Status

GOOD, WAITING, BAD, DIM = "green", "yellow", "bold red", "dim"
_STATES = {"ready": GOOD, "starting": WAITING, "degraded": WAITING, "stopped": DIM, "failed": BAD}


def view(status: Status) -> Group:
    """One look at an instance."""
    recording = [Text(status.recording.line())] if status.recording else []
    commands = [Text(refusal, WAITING)] if (refusal := status.settings.ros_refusal) else []
    shown = Group(*_heading(status), *commands, *_robot(status), _services(status), *_hosts(status), *recording)
    if status.beyond_age is not None:
        shown.renderables.append(Text(f"robot's side: through the link, at most {status.beyond_age:.1f} s ago"))
    return shown


def show(look: Callable[[], Status], period: float) -> NoReturn:
    """Look again and again, on a terminal in one place, elsewhere one below the other."""
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
    pace = f"{clock.mode}: {clock.real_time_factor:.2f} × real time in the last second"
    if status.factor_since_start is not None:
        pace += f", {status.factor_since_start:.3f} since the start ({clock.slip:.2f} s lost)"
    return [heading.append(f", {clock.time * 1e-9:.1f} s of robot time"), Text(pace)]


def _robot(status: Status) -> list[Text]:
    """What the robot does; where it wants somebody: why, since when, what to do, and where it is recorded."""
    behavior, condition = status.behavior or "?", status.condition
    colour = BAD if status.fallen else WAITING if behavior in WAY_OUT else "bold"
    lines = [
        Text.assemble(
            "control mode ", (status.control_mode or "?", "bold"), ", behavior ", (behavior, colour),
            f" for {time.time() - condition.began:.0f} s" if condition else "",
        )
    ]  # fmt: skip
    if condition is None:
        return lines
    if status.way_out is None:
        return [lines[0].append(f": {condition.reason}")]
    word = "fallen" if status.fallen else behavior
    began = f"{datetime.fromtimestamp(condition.began):%H:%M:%S} ({condition.since:.1f} s of robot time)"
    lines.append(Text(f"{word} since {began}: {condition.reason}", colour))
    lines.append(Text.assemble("→ ", (status.way_out, "bold")))
    if status.fallen:
        lines.append(
            Text(f"recorded in {condition.bag}" if condition.bag else "not recorded", "" if condition.bag else WAITING)
        )
    return lines


def _services(status: Status) -> Table:
    """How they fare; beside what each takes, its budget."""
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
    """Where the processes run, and what is wrong with a host."""
    if not status.hosts:
        return []
    shown = table("host", "address", "processes")
    shown.add_column("", overflow="fold")
    for host in status.hosts:
        shown.add_row(host.name, host.address, ", ".join(host.processes) or "–", Text(host.problem, BAD))
    return [shown]


def _of(taken: float | None, budget: float) -> str:
    return f"{'–' if taken is None else f'{taken:.0f}'} of {budget:.0f}"
