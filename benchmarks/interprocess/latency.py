"""One-way latency and CPU time of all transports, interleaved so that the machine's load falls alike on all."""

from __future__ import annotations

import contextlib
import statistics
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import psutil

from benchmarks.interprocess import transports
from benchmarks.interprocess.ends import Process

REFERENCE = "pyzmq curve"
THREADS = " (threads)"  # both ends in one process
_SKIPPED = 0.1  # of the messages of a slice, the first: caches are cold from the slice before
_CONNECT = 20.0  # [s]


@dataclass
class Row:
    """What one transport did with one payload at one rate.

    Attributes:
        transport: its name.
        payload: its name.
        rate: messages a second; 0: as fast as it goes.
        latencies: of each slice, or of each tenth of the whole [µs].
        sent: messages.
        received: messages.
        cpu: of both ends, all threads, while it ran [s].
        seconds: how long it sent.
        busy: the machine's cores, of all processes, while it ran [%].
    """

    transport: str
    payload: str
    rate: float
    latencies: list[npt.NDArray[np.float64]] = field(default_factory=list)
    sent: int = 0
    received: int = 0
    cpu: float = 0.0
    seconds: float = 0.0
    busy: list[float] = field(default_factory=list)

    def summary(self, reference: Row | None) -> dict[str, Any]:
        """The numbers of the table; latencies and CPU in µs.

        Args:
            reference: the row of ``REFERENCE`` at the same payload and rate. The ratio of medians is taken slice by
                slice, each against its own neighbor in time, and the median of these is told.
        """
        numbers: dict[str, Any] = {key: getattr(self, key) for key in ("transport", "payload", "rate")}
        everything = np.concatenate(self.latencies) if self.latencies else np.empty(0)
        if len(everything):
            median, p99 = np.quantile(everything, (0.5, 0.99))
            numbers |= {"median": median, "p99": p99, "mean": everything.mean(), "sd": everything.std()}
            numbers = {key: float(value) if isinstance(value, np.floating) else value for key, value in numbers.items()}
        if reference is not None and reference.latencies and self.latencies:
            pairs = zip(self.latencies, reference.latencies, strict=False)
            ratios = [float(np.median(own) / np.median(its)) for own, its in pairs if len(own) and len(its)]
            numbers["ratio"] = statistics.median(ratios) if ratios else None
        numbers["cpu"] = self.cpu / max(1, self.received or self.sent) * 1e6
        numbers["received_per_second"] = self.received / max(1e-9, self.seconds)
        numbers["lost"] = 1.0 - self.received / max(1, self.sent)
        numbers["busy"] = statistics.fmean(self.busy) if self.busy else None
        numbers["messages"] = len(everything)
        return numbers


@dataclass
class Pair:
    """The two ends of one transport; one process, if they are threads of it."""

    name: str
    sender: Process
    receiver: Process
    payloads: list[str]

    def cpu(self) -> float:
        """Of both ends so far [s]."""
        return float(sum(end.do("cpu") for end in {id(e): e for e in (self.sender, self.receiver)}.values()))


@contextlib.contextmanager
def pairs(names: list[str], payloads: list[str], folder: Path, environment: dict[str, str]) -> Iterator[list[Pair]]:
    """Start the ends of all transports and wait until messages pass; those that cannot are told of and left out."""
    with contextlib.ExitStack() as stack:
        ready: list[Pair] = []
        for name in names:
            place = folder / name.replace(" ", "_").replace("(", "").replace(")", "")
            place.mkdir()
            transport = name.removesuffix(THREADS)
            try:
                if name.endswith(THREADS):
                    both = stack.enter_context(Process(place, "both", environment))
                    both.do("open", transport, str(place), payloads[:1], "sender and receiver")
                    pair = Pair(name, both, both, payloads[:1])
                else:
                    sender = stack.enter_context(Process(place, "sender", environment))
                    receiver = stack.enter_context(Process(place, "receiver", environment))
                    sender.start("open", transport, str(place), payloads, "sender")
                    receiver.start("open", transport, str(place), payloads, "receiver")
                    sender.finish()
                    receiver.finish()
                    pair = Pair(name, sender, receiver, payloads)
                _connect(pair)
            except (RuntimeError, TimeoutError) as error:
                print(f"skipped: {name}: {error}", file=sys.stderr)
                continue
            ready.append(pair)
        yield ready


def _connect(pair: Pair) -> None:
    """Send until everything arrives, and warm up."""
    deadline = time.monotonic() + _CONNECT
    while True:
        for payload in pair.payloads:
            pair.sender.do("send", payload, 10, 100.0, time.monotonic())
        received = pair.receiver.do("received")
        if pair.name.startswith("nothing") or all(received[payload] >= 20 for payload in pair.payloads):
            break
        if time.monotonic() > deadline:
            silent = ", ".join(p for p in pair.payloads if received[p] < 20)
            raise TimeoutError(f"{silent} did not arrive within {_CONNECT:g} s")
    for payload in pair.payloads:
        pair.receiver.do("take", payload)


def together(ready: list[Pair], rate: float, seconds: float) -> list[Row]:
    """All transports and payloads at once, each at a low rate and all at equal distances in time."""
    streams = [(pair, payload) for payload in ready[0].payloads for pair in ready if payload in pair.payloads]
    count = max(1, int(rate * seconds))
    before = {pair.name: pair.cpu() for pair in ready}
    start = time.monotonic() + 0.5
    psutil.cpu_percent()
    for pair in ready:
        own = [(p, start + i / len(streams) / rate) for i, (each, p) in enumerate(streams) if each is pair]
        pair.sender.start("send_all", own, count, rate)
    for pair in ready:
        pair.sender.finish()
    busy = psutil.cpu_percent()
    rows = []
    for pair, payload in streams:
        taken = pair.receiver.do("take", payload)
        row = Row(pair.name, payload, rate, sent=count, received=len(taken), seconds=seconds, busy=[busy])
        row.latencies = list(np.array_split(taken, 10))
        rows.append(row)
    for pair in ready:
        used = (pair.cpu() - before[pair.name]) / len(pair.payloads)
        for row in rows:
            if row.transport == pair.name:
                row.cpu = used
    return rows


def in_turn(ready: list[Pair], rate: float, seconds: float, rounds: int) -> list[Row]:
    """One transport and payload after another in short slices, several rounds; rate 0: as fast as it goes."""
    rows: dict[tuple[str, str], Row] = {}
    for number in range(rounds):
        turn = number * len(ready) // rounds
        for payload in ready[0].payloads:
            for pair in (*ready[turn:], *ready[:turn]):
                if payload in pair.payloads and (rate or not pair.name.startswith("nothing")):
                    row = rows.setdefault((payload, pair.name), Row(pair.name, payload, rate))
                    _slice(pair, row, seconds)
    return [rows[key] for key in sorted(rows, key=lambda key: ready[0].payloads.index(key[0]))]


def _slice(pair: Pair, row: Row, seconds: float) -> None:
    psutil.cpu_percent()
    cpu, before = pair.cpu(), time.monotonic()
    if row.rate:
        count = max(10, int(row.rate * seconds))
        pair.sender.do("send", row.payload, count, row.rate, time.monotonic())
    else:
        count = pair.sender.do("flood", row.payload, seconds)
    row.seconds += time.monotonic() - before
    taken = pair.receiver.do("take", row.payload)
    row.cpu += pair.cpu() - cpu
    row.busy.append(psutil.cpu_percent())
    row.sent += count
    row.received += len(taken)
    row.latencies.append(taken[int(_SKIPPED * len(taken)) :])


def available(asked: list[str]) -> list[str]:
    """Those that can be measured here; the others are told of."""
    found = []
    for name in asked:
        why = transports.missing(name)
        if why is None:
            found.append(name)
        else:
            print(f"skipped: {name}: {why}", file=sys.stderr)
    return found


def as_plain(row: Row, reference: Row | None) -> dict[str, Any]:
    """A row for JSON: the summary, and the medians of its slices [µs]."""
    medians = [float(np.median(part)) for part in row.latencies if len(part)]
    return row.summary(reference) | {"slice_medians": medians}
