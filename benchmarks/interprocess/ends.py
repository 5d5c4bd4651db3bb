"""The processes at the ends of a transport, and how the benchmark tells them what to do."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from multiprocessing.connection import Client, Connection, Listener
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from benchmarks.interprocess import transports
from benchmarks.interprocess.transports import Place

SCRIPT = Path(__file__).resolve().parents[1] / "ipc.py"


class End:
    """What an end does: holds the senders, the receivers, or both, of one transport, one for each payload."""

    def __init__(self, transport: str, folder: str, payloads: list[str], roles: str) -> None:
        adapter, place = transports.adapter(transport), Place(Path(folder))
        self._senders = {p: adapter.Sender(place, p) for p in payloads} if "sender" in roles else {}
        self._receivers = {p: adapter.Receiver(place, p) for p in payloads} if "receiver" in roles else {}
        self._latencies: dict[str, list[int]] = {p: [] for p in payloads}
        self._stopping = False
        self._threads = [threading.Thread(target=self._receive, args=(p,)) for p in self._receivers]
        for thread in self._threads:
            thread.start()

    def _receive(self, payload: str) -> None:
        now, append = time.monotonic_ns, self._latencies[payload].append
        self._receivers[payload].run(lambda stamp: append(now() - stamp), lambda: self._stopping)

    def cpu(self) -> float:
        """Of the process and all its threads since it started [s]."""
        return time.process_time()

    def send(self, payload: str, count: int, rate: float, start: float) -> None:
        """Send at a rate [Hz], from a time on (monotonic [s])."""
        self.send_all([(payload, start)], count, rate)

    def send_all(self, streams: list[tuple[str, float]], count: int, rate: float) -> None:
        """Send several payloads at one rate, each from a time on."""
        due = sorted((start + i / rate, payload) for payload, start in streams for i in range(count))
        for at, payload in due:
            time.sleep(max(0.0, at - time.monotonic()))
            self._senders[payload].send()

    def flood(self, payload: str, seconds: float) -> int:
        """Send as fast as it goes; returns how many."""
        send, count, end = self._senders[payload].send, 0, time.monotonic() + seconds
        while time.monotonic() < end:
            send()
            count += 1
        return count

    def received(self) -> dict[str, int]:
        """How many since they were last taken."""
        return {payload: len(latencies) for payload, latencies in self._latencies.items()}

    def take(self, payload: str) -> npt.NDArray[np.float64]:
        """What was measured since this was last asked [µs]; waits until nothing has come for a while."""
        latencies = self._latencies[payload]
        seen, quiet_since = len(latencies), time.monotonic()
        while time.monotonic() - quiet_since < 0.05:
            time.sleep(0.01)
            if len(latencies) != seen:
                seen, quiet_since = len(latencies), time.monotonic()
        taken = np.array(latencies, np.float64) / 1e3
        latencies.clear()
        return taken

    def close(self) -> None:
        """Close everything."""
        self._stopping = True
        for thread in self._threads:
            thread.join()
        for sender in self._senders.values():
            sender.close()
        for receiver in self._receivers.values():
            receiver.close()


def serve(address: str, kinds: Mapping[str, Callable[..., object]]) -> None:
    """Do as told over a socket until it closes: first become one of the kinds, then call its methods."""
    with Client(address, "AF_UNIX") as connection, contextlib.suppress(EOFError):
        made: object = None
        while True:
            name, arguments = connection.recv()
            try:
                if name in kinds:
                    made, answer = kinds[name](*arguments), None
                else:
                    answer = getattr(made, name)(*arguments)
            except Exception:
                connection.send((False, traceback.format_exc()))
                continue
            connection.send((True, answer))
            if name == "close":
                os._exit(0)  # some libraries hang when they are taken down


class Process:
    """A process that does as told, seen from here."""

    def __init__(self, folder: Path, name: str, environment: dict[str, str]) -> None:
        address = str(folder / f"{name}.socket")
        self._log = folder / f"{name}.log"
        with Listener(address, "AF_UNIX") as listener, open(self._log, "wb") as log:
            self._process = subprocess.Popen(
                [sys.executable, str(SCRIPT), "--end", address], env=environment, stdout=log, stderr=log
            )
            self._connection: Connection[Any, Any] = listener.accept()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def start(self, name: str, *arguments: object) -> None:
        """Have it do something."""
        self._connection.send((name, arguments))

    def finish(self) -> Any:
        """Wait until it is done.

        Raises:
            RuntimeError: it could not; with its traceback.
        """
        try:
            done, answer = self._connection.recv()
        except EOFError:
            raise RuntimeError(f"a process ended with {self._process.wait()}: {self._last_words()}") from None
        if not done:
            raise RuntimeError(str(answer).strip().splitlines()[-1])
        return answer

    def _last_words(self) -> str:
        return (self._log.read_text(errors="replace").strip().splitlines() or ["without a word"])[-1]

    def do(self, name: str, *arguments: object) -> Any:
        """Have it do something, and wait until it is done."""
        self.start(name, *arguments)
        return self.finish()

    def close(self) -> None:
        """End it."""
        with contextlib.suppress(OSError, RuntimeError):
            self.start("close")
            if self._connection.poll(5.0):
                self.finish()
        self._connection.close()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
