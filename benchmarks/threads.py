"""What a thread costs in one Python process: handing a value over, and sharing the interpreter (docs: threads).

Figure 4.2 of the thesis gives each loop of the VRC a thread of its own. Here a value is handed from one thread to
another that waits for it, 250 times a second as the update loop would, while nobody else works and while a third
thread does; beside it stands the same call made without a thread.

    .venv/bin/python benchmarks/threads.py [--seconds 5]
"""

from __future__ import annotations

import argparse
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from rich.console import Console
from rich.table import Table

from valor.valor_ros_controller.realtime_buffer import RealTimeBuffer
from valor.valor_ros_controller.service import SWITCH_INTERVAL

RATE = 250.0  # [Hz]


class Direct:
    """No thread: the call itself."""

    def __init__(self, taken: Callable[[int], None]) -> None:
        self._taken = taken

    def give(self, value: int) -> None:
        self._taken(value)

    def close(self) -> None: ...


class ByThread:
    """A real-time buffer and an event, as to the behavior commander."""

    def __init__(self, taken: Callable[[int], None]) -> None:
        self._taken = taken
        self._buffer: RealTimeBuffer[int] = RealTimeBuffer()
        self._wake = threading.Event()
        self._closing = False
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def give(self, value: int) -> None:
        self._buffer.write(value)
        self._wake.set()

    def close(self) -> None:
        self._closing = True
        self._wake.set()
        self._thread.join()

    def _run(self) -> None:
        while True:
            self._wake.wait()
            self._wake.clear()
            if self._closing:
                return
            if (value := self._buffer.read()) is not None:
                self._taken(value)


@contextmanager
def neighbor(share: float) -> Iterator[None]:
    """A third thread that keeps the interpreter busy for a share of the time, two milliseconds at a time."""
    ending = threading.Event()

    def work() -> None:
        while not ending.is_set():
            until = time.perf_counter() + 0.002
            while time.perf_counter() < until:
                pass
            ending.wait(0.002 * (1.0 - share) / share)

    thread = threading.Thread(target=work)
    if share:
        thread.start()
    yield
    ending.set()
    if share:
        thread.join()


def measure(kind: type[Direct] | type[ByThread], share: float, seconds: float) -> tuple[np.ndarray, float]:
    """Delays [s] and the CPU of a hand-over [s], pacing included."""
    delays: list[float] = []
    hand = kind(lambda sent: delays.append((time.perf_counter_ns() - sent) * 1e-9))
    with neighbor(share):
        cpu, due = time.process_time(), time.monotonic()
        end = due + seconds
        while due < end:
            hand.give(time.perf_counter_ns())
            due += 1.0 / RATE
            time.sleep(max(0.0, due - time.monotonic()))
        cpu = time.process_time() - cpu
    hand.close()
    return np.array(delays), cpu / max(1, len(delays))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=5.0, help="a row")
    options = parser.parse_args()
    table = Table(title=f"Handing over at {RATE:g} Hz, load {os.getloadavg()[0]:.1f}, {os.cpu_count()} cores")
    for heading in ("to", "interpreter", "switch interval [ms]", "median [µs]", "99 % [µs]", "max [µs]", "CPU [µs]"):
        table.add_column(heading, justify="left" if heading in ("to", "interpreter") else "right")
    for kind, name in ((Direct, "the same thread"), (ByThread, "another thread")):
        for share, interval in ((0.0, SWITCH_INTERVAL), (0.3, SWITCH_INTERVAL), (0.3, 0.005)):
            if kind is Direct and share:
                continue
            sys.setswitchinterval(interval)
            delays, cpu = measure(kind, share, options.seconds)
            quantiles = (f"{np.quantile(delays, q) * 1e6:.0f}" for q in (0.5, 0.99, 1.0))
            busy = f"busy {share:.0%}" if share else "free"
            table.add_row(name, busy, f"{interval * 1e3:g}", *quantiles, "–" if share else f"{cpu * 1e6:.0f}")
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
