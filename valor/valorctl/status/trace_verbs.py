"""``trace``."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from valor.common import whole_file
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.valorctl.terminal.console import Interruption, bar, say

if TYPE_CHECKING:
    from valor.common.trace import Trace

LOOPS = ("comms_manager", "motion_manager", "valor_ros_controller", "bag_recorder")  # services that mark their stages
_SWITCHING = 0.5  # until all services have switched their marks on [s]
_QUEUE = 1000  # messages a service: minutes
_POLL = 0.05  # [s]

Event = dict[str, Any]


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command()(trace)


def trace(
    seconds: Annotated[float, typer.Option("--for", min=0.1, max=120.0, help="Duration [s].")] = 5.0,
    out: Annotated[Path, typer.Option(help="The file; Perfetto (ui.perfetto.dev) opens it.")] = Path("trace.json"),
) -> None:
    """Record what each process's loop does when, as a Chrome trace file."""
    import msgspec

    instance = Instance.from_environment()
    with Interruption() as interruption, bar("tracing", seconds, "s") as shown:
        found = listen(instance, seconds, interruption.check, shown)
    if not any(found.values()):
        raise ValorError(f"no marks from {', '.join(LOOPS)} in {seconds:g} s; `valorctl status` shows their state")
    events = [event for name, traces in found.items() for event in chrome_events(name, LOOPS.index(name) + 1, traces)]
    try:
        whole_file.write(out, msgspec.json.encode({"traceEvents": events, "displayTimeUnit": "ms"}))
    except OSError as error:
        raise ValorError(f"{error.filename}: {error.strerror}") from None
    say(f"{out}: {len(events)} events; open it in https://ui.perfetto.dev")
    if silent := [name for name, traces in found.items() if not traces]:
        say(f"no marks from {', '.join(silent)}")


def listen(
    instance: Instance, seconds: float, check: Callable[[], None], shown: Callable[[float], None]
) -> dict[str, list[Trace]]:
    """Receive the marks of a running instance for some seconds, by service that marks its stages.

    ``check`` is called in between and may raise; ``shown`` receives the time passed [s].
    """
    from valor.common.trace import FLUSH_PERIOD, Trace, topic
    from valor.valorctl.drive.node import join
    from valor.valorctl.instance.running import require_up

    processes = require_up(instance).processes()
    names = [name for name in LOOPS if name in processes and processes[name].pid]
    with join(instance, "valorctl_trace") as node:
        subscribers = {name: node.subscriber(topic(name), Trace, queue=_QUEUE) for name in names}
        _wait(_SWITCHING, check, lambda _: None)
        for subscriber in subscribers.values():
            subscriber.drain()
        _wait(seconds, check, shown)
        _wait(2.0 * FLUSH_PERIOD, check, lambda _: None)
        return {name: [received.message for received in each.drain()] for name, each in subscribers.items()}


def chrome_events(service: str, pid: int, traces: Sequence[Trace]) -> Iterator[Event]:
    """Events of the Chrome trace format: a slice per stage, and one per run of the garbage collector on a second track.

    ``service`` and ``pid`` are name and number of the process in the viewer. Without two marks there are no events.
    """
    from valor.common.trace import Stage

    yield _named("process_name", pid, 0, service)
    yield _named("thread_name", pid, 1, "loop")
    yield _named("thread_name", pid, 2, "garbage collector")
    before: tuple[float, float] | None = None  # end and processor time of the previous stage [s]
    for message in traces:
        columns = (message.stages.tolist(), message.at.tolist(), message.cpu.tolist(), message.sequence.tolist())
        for stage, at, cpu, sequence in zip(*columns, strict=True):
            if stage == Stage.COLLECT:
                yield _slice("collect", pid, 2, (cpu, at), {})
                continue
            if before is not None:
                arguments = {"cpu_us": round(1e6 * (cpu - before[1]), 1)}
                if sequence:
                    arguments["proprioceptor"] = int(sequence)
                yield _slice(Stage(stage).name.lower().replace("_", " "), pid, 1, (before[0], at), arguments)
            before = at, cpu


def _named(what: str, pid: int, tid: int, name: str) -> Event:
    return {"ph": "M", "name": what, "pid": pid, "tid": tid, "args": {"name": name}}


def _slice(name: str, pid: int, tid: int, span: tuple[float, float], arguments: Mapping[str, float]) -> Event:
    start, end = (1e6 * at for at in span)
    times = {"ts": round(start, 3), "dur": round(end - start, 3)}
    return {"ph": "X", "name": name, "pid": pid, "tid": tid, **times, "args": dict(arguments)}


def _wait(duration: float, check: Callable[[], None], shown: Callable[[float], None]) -> None:
    started = time.monotonic()
    while (passed := time.monotonic() - started) < duration:
        check()
        shown(passed)
        time.sleep(min(_POLL, duration - passed))
