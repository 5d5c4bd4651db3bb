"""What Bifrost costs as a network grows: subscribers, topics, nodes that come at once; and as nodes come and go."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import psutil

import bifrost
from benchmarks.interprocess.ends import Process
from benchmarks.interprocess.payloads import Proprioceptor, proprioceptor

_CROWDS = 4  # processes that share the nodes of a crowd
_PATIENCE = 120.0  # [s]


class Crowd:
    """Many nodes, or many topics, in one process; told what to do over ``ends.serve``."""

    def __init__(self) -> None:
        self._nodes: list[bifrost.Node] = []
        self._publishers: list[bifrost.Publisher[Proprioceptor]] = []
        self._subscribers: list[bifrost.Subscriber[Proprioceptor]] = []
        self._heard: dict[int, int] = {}  # subscriber's index to messages
        self._latencies: list[int] = []
        self._stopping = False
        self._thread = threading.Thread(target=self._listen)

    def join(self, name: str, count: int) -> None:
        """Make nodes."""
        self._nodes += [bifrost.Node(f"{name}_{i}") for i in range(count)]

    def publish_on(self, topics: list[str]) -> None:
        """Publishers of the first node."""
        self._publishers += [self._nodes[0].publisher(topic, Proprioceptor) for topic in topics]

    def subscribe_to(self, topics: list[str], queue: int | None = None) -> None:
        """One subscriber for each topic at every node; a thread takes what comes to any of them."""
        self._subscribers += [
            node.subscriber(topic, Proprioceptor, queue=queue) for node in self._nodes for topic in topics
        ]
        self._thread.start()

    def _listen(self) -> None:
        index = {subscriber: i for i, subscriber in enumerate(self._subscribers)}
        while not self._stopping:
            for subscriber in bifrost.wait(self._subscribers, timeout=0.1):
                for received in subscriber.drain():
                    self._latencies.append(time.monotonic_ns() - received.message.time)
                    self._heard[index[subscriber]] = self._heard.get(index[subscriber], 0) + 1

    def heard(self) -> int:
        """How many of the subscribers have heard anything."""
        return len(self._heard)

    def silent(self) -> list[int]:
        """Which have not."""
        return [i for i in range(len(self._subscribers)) if i not in self._heard]

    def take(self) -> list[int]:
        """Latencies since this was last asked [ns]."""
        taken = self._latencies.copy()
        self._latencies.clear()
        return taken

    def know(self, names: int) -> bool:
        """Whether every node knows so many."""
        return all(node.discovery.registered and len(node.discovery.records()) >= names for node in self._nodes)

    def lost(self) -> int:
        """Messages known lost or refused by all subscribers."""
        return sum(subscriber.drops + subscriber.rejected for subscriber in self._subscribers)

    def come_and_go(self, seconds: float, rate: float) -> int:
        """Nodes with a publisher and a subscriber each that come and leave at once; returns how many."""
        count, due, end = 0, time.monotonic(), time.monotonic() + seconds
        while time.monotonic() < end:
            with bifrost.Node(f"guest_{os.getpid()}_{count}") as guest:
                guest.publisher(f"benchmark/guest_{count}", Proprioceptor)
                guest.subscriber("benchmark/state", Proprioceptor)
            count += 1
            due += 1.0 / rate
            time.sleep(max(0.0, due - time.monotonic()))
        return count

    def publish(self, count: int, rate: float, publishers: Sequence[int] = (0,)) -> list[float]:
        """Publish with some of the publishers; how long each call took [s]."""
        message, took, due = proprioceptor(), [], time.monotonic()
        for _ in range(count):
            for publisher in [self._publishers[i] for i in publishers]:
                message.time = time.monotonic_ns()
                before = time.perf_counter()
                publisher.publish(message)
                took.append(time.perf_counter() - before)
            due += 1.0 / rate
            time.sleep(max(0.0, due - time.monotonic()))
        return took

    def cpu(self) -> float:
        """Of the process so far [s]."""
        return time.process_time()

    def memory(self) -> float:
        """Of the process [MiB]."""
        return float(psutil.Process().memory_info().rss / 2**20)

    def close(self) -> None:
        """Leave."""
        self._stopping = True
        if self._thread.is_alive():
            self._thread.join()
        for node in self._nodes:
            node.close()


@contextlib.contextmanager
def _crowds(folder: Path, count: int) -> Iterator[list[Process]]:
    with contextlib.ExitStack() as stack:
        made = [stack.enter_context(Process(folder, f"crowd_{i}", dict(os.environ))) for i in range(count)]
        for process in made:
            process.do("crowd")
        yield made


def _median(values: list[float]) -> float:
    return float(np.median(values)) if values else float("nan")


def _subscribers(folder: Path, numbers: list[int], daemon: psutil.Process) -> list[dict[str, float]]:
    """One publisher and more and more subscribers, each a node of its own."""
    print("\nsubscribers of one topic, each a node; Proprioceptor at 50 Hz")
    print(f"{'subscribers':>12}{'publish [µs]':>14}{'CPU/message [µs]':>18}{'latency [µs]':>14}{'memory [MiB]':>14}")
    rows = []
    for number in numbers:
        with _crowds(folder, 1 + _CROWDS) as (publisher, *crowds):
            publisher.do("join", "publisher", 1)
            publisher.do("publish_on", ["benchmark/state"])
            shares = [number // _CROWDS + (i < number % _CROWDS) for i in range(_CROWDS)]
            for crowd, share in zip(crowds, shares, strict=True):
                crowd.do("join", "subscriber", share)
                crowd.do("subscribe_to", ["benchmark/state"])
            deadline = time.monotonic() + _PATIENCE
            while sum(crowd.do("heard") for crowd in crowds) < number and time.monotonic() < deadline:
                publisher.do("publish", 1, 50.0)
            for crowd in crowds:
                crowd.do("take")
            before = publisher.do("cpu")
            took = publisher.do("publish", 100, 50.0)
            cpu = publisher.do("cpu") - before
            latencies = [latency / 1e3 for crowd in crowds for latency in crowd.do("take")]
            row = {"subscribers": number, "publish": _median(took) * 1e6, "cpu": cpu / len(took) * 1e6}
            row |= {"latency": _median(latencies), "memory": publisher.do("memory")}
        rows.append(row)
        print(f"{number:>12}{row['publish']:>14.0f}{row['cpu']:>18.0f}{row['latency']:>14.0f}{row['memory']:>14.1f}")
    grown = (rows[-1]["memory"] - rows[0]["memory"]) / (rows[-1]["subscribers"] - rows[0]["subscribers"])
    print(f"memory a connection at the publisher: {grown * 1024:.0f} kiB")
    return rows


def _topics(folder: Path, numbers: list[int], daemon: psutil.Process) -> list[dict[str, float]]:
    """Two nodes with more and more topics between them."""
    print("\ntopics between two nodes, a Proprioceptor on one of them at 100 Hz")
    print(f"{'topics':>12}{'discovery [s]':>14}{'latency [µs]':>14}{'publisher [MiB]':>17}{'subscriber [MiB]':>18}")
    rows = []
    for number in numbers:
        with _crowds(folder, 2) as (publisher, subscriber):
            topics = [f"benchmark/topic_{i}" for i in range(number)]
            for process in (publisher, subscriber):
                process.do("join", "node", 1)
            start = time.monotonic()
            publisher.start("publish_on", topics)
            subscriber.start("subscribe_to", topics)
            publisher.finish()
            subscriber.finish()
            while (silent := subscriber.do("silent")) and time.monotonic() < start + _PATIENCE:
                publisher.do("publish", 1, 10.0, silent)
            discovery = time.monotonic() - start if not silent else float("nan")
            subscriber.do("take")
            publisher.do("publish", 100, 100.0)
            latency = _median(subscriber.do("take")) / 1e3
            row = {"topics": number, "discovery": discovery, "latency": latency}
            row |= {"publisher_memory": publisher.do("memory"), "subscriber_memory": subscriber.do("memory")}
        rows.append(row)
        memory = f"{row['publisher_memory']:>17.1f}{row['subscriber_memory']:>18.1f}"
        print(f"{number:>12}{discovery:>14.2f}{latency:>14.0f}{memory}", flush=True)
    return rows


def _joining(folder: Path, numbers: list[int], daemon: psutil.Process) -> list[dict[str, float]]:
    """Nodes that come at once, until each knows all."""
    print("\nnodes that come at once, until each knows all")
    print(f"{'nodes':>12}{'discovery [s]':>14}{'CPU of bifrostd [s]':>21}{'bifrostd [MiB]':>16}")
    rows = []
    for number in numbers:
        with _crowds(folder, _CROWDS) as crowds:
            shares = [number // _CROWDS + (i < number % _CROWDS) for i in range(_CROWDS)]
            before, start = sum(daemon.cpu_times()[:2]), time.monotonic()
            for crowd, share in zip(crowds, shares, strict=True):
                crowd.start("join", "node", share)
            for crowd in crowds:
                crowd.finish()
            while not all(crowd.do("know", number) for crowd in crowds) and time.monotonic() < start + _PATIENCE:
                time.sleep(0.01)
            row = {"nodes": number, "discovery": time.monotonic() - start}
            row |= {"cpu": sum(daemon.cpu_times()[:2]) - before, "memory": daemon.memory_info().rss / 2**20}
        rows.append(row)
        print(f"{number:>12}{row['discovery']:>14.2f}{row['cpu']:>21.2f}{row['memory']:>16.1f}", flush=True)
    return rows


def _coming_and_going(folder: Path, seconds: list[int], daemon: psutil.Process) -> list[dict[str, float]]:
    """24 joins and leaves a second beside a stream of 200 messages a second, all of which must arrive."""
    print("\nnodes that come and go, 24 a second, beside 200 messages a second to a queue")
    header = f"{'seconds':>12}{'joined':>10}{'messages':>10}{'lost':>8}"
    print(f"{header}{'CPU of bifrostd [%]':>21}{'bifrostd grew [MiB]':>21}")
    rows = []
    for duration in seconds:
        with _crowds(folder, 4) as (publisher, listener, *guests):
            for process in (publisher, listener):
                process.do("join", "node", 1)
            publisher.do("publish_on", ["benchmark/state"])
            listener.do("subscribe_to", ["benchmark/state"], 10_000)
            deadline = time.monotonic() + _PATIENCE
            while not listener.do("heard") and time.monotonic() < deadline:
                publisher.do("publish", 1, 50.0)
            listener.do("take")
            cpu, memory = sum(daemon.cpu_times()[:2]), daemon.memory_info().rss
            publisher.start("publish", 200 * duration, 200.0)
            for guest in guests:
                guest.start("come_and_go", float(duration), 24.0 / len(guests))
            joined = sum(guest.finish() for guest in guests)
            publisher.finish()
            time.sleep(0.5)
            row = {"seconds": duration, "joined": joined}
            row |= {"messages": len(listener.do("take")), "lost": listener.do("lost")}
            row |= {"cpu": (sum(daemon.cpu_times()[:2]) - cpu) / duration * 100.0}
            row |= {"grown": (daemon.memory_info().rss - memory) / 2**20}
        rows.append(row)
        print(
            f"{duration:>12}{joined:>10}{row['messages']:>10}{row['lost']:>8}{row['cpu']:>21.1f}{row['grown']:>21.1f}",
            flush=True,
        )
    return rows


def measure(folder: Path, daemon_pid: int, quick: bool) -> dict[str, Any]:
    """Print four tables; returns them for JSON."""
    daemon = psutil.Process(daemon_pid)
    few, many, most = ([1, 10], [1, 100], [1, 20]) if quick else ([1, 10, 100], [1, 100, 1000], [1, 10, 100])
    longest = [5] if quick else [60]
    results = {}
    for name, part, numbers in (
        ("subscribers", _subscribers, few),
        ("topics", _topics, many),
        ("joining", _joining, most),
        ("coming and going", _coming_and_going, longest),
    ):
        place = folder / name.replace(" ", "_")
        place.mkdir()
        try:
            results[name] = part(place, numbers, daemon)
        except RuntimeError as error:
            print(f"{name}: {error}", file=sys.stderr)
    return results
