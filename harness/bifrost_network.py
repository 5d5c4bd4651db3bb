"""A Bifrost network for one test: daemon and peers are processes, nodes live in the test."""

from __future__ import annotations

import functools
import json
import os
import signal
import socket as sockets
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
import psutil

import bifrost
from bifrost import Computer
from bifrost.network import own_key_file
from harness.places import REPOSITORY
from harness.waiting import PATIENCE

T = TypeVar("T")


class Sample(bifrost.Message):
    """What peers publish."""

    count: int
    label: str
    values: bifrost.Float64Array
    flags: bifrost.Uint8Array


class Question(bifrost.Message):
    """What peers are asked."""

    action: str
    argument: float


class Answer(bifrost.Message):
    """What they reply."""

    text: str
    handled: int


def sample(count: int, size: int = 38) -> Sample:
    """A message whose content follows from its count."""
    values = np.arange(size, dtype=np.float64) + count
    return Sample(count, f"sample {count}", values, np.full(size, count % 256, np.uint8))


def until(condition: Callable[[], T | Literal[False] | None], what: str, timeout: float = 10.0) -> T:
    """Poll until true; the failure names what was waited for."""
    timeout = max(timeout, PATIENCE)
    deadline = time.monotonic() + timeout
    while not (value := condition()):
        assert time.monotonic() < deadline, f"not within {timeout:g} s: {what}"
        time.sleep(0.01)
    return value


@contextmanager
def going_on(do: Callable[[], object]) -> Iterator[None]:
    """Do it again and again, as quickly as it goes."""
    stop = threading.Event()

    def loop() -> None:
        while not stop.is_set():
            do()

    thread = threading.Thread(target=loop)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def two_computers(folder: Path, ports: Sequence[int]) -> list[Computer]:
    """Near and far: two addresses of the loopback interface, and a port that is free on either."""
    port = bifrost.Network.create(folder / "one.json", folder / "keys", "0.0.0.0", ports).computer.port
    return [Computer("near", "127.0.0.1", port), Computer("far", "127.0.0.2", port)]


def ports(pid: int) -> list[int]:
    """The TCP ports that a process listens on."""
    return sorted(c.laddr.port for c in psutil.Process(pid).net_connections("tcp") if c.status == psutil.CONN_LISTEN)


def mechanism(port: int) -> str:
    """The ZMTP security mechanism that a port offers, before it has heard of ours."""
    answer = b""
    with sockets.create_connection(("127.0.0.1", port), timeout=10.0) as connection:
        connection.sendall(b"\xff" + bytes(8) + b"\x7f\x03\x01")
        while len(answer) < 64 and (more := connection.recv(64)):
            answer += more
    return answer[12:32].rstrip(b"\0").decode(errors="replace")


class Peer:
    """A process of the network; what it prints is JSON, a line each."""

    def __init__(self, environment: dict[str, str], *arguments: str, within: Sequence[str] = ()) -> None:
        self.process = subprocess.Popen(
            [*within, sys.executable, "-m", "harness.bifrost_peer", *arguments],
            cwd=REPOSITORY,
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self.line() == "ready"

    @property
    def pid(self) -> int:
        """Of the process."""
        return self.process.pid

    def line(self) -> Any:
        """The next that it prints."""
        assert self.process.stdout is not None
        text = self.process.stdout.readline()
        assert text, f"the peer ended with {self.process.wait()}"
        return json.loads(text)

    def signal(self, number: signal.Signals) -> None:
        """Send a signal."""
        self.process.send_signal(number)

    def alive(self) -> bool:
        """Return whether it runs."""
        return self.process.poll() is None

    def kill(self) -> None:
        """SIGKILL, and wait."""
        self.process.kill()
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()


class BifrostNetwork:
    """The network, its daemons, and everything that a test started in it."""

    def __init__(
        self,
        folder: Path,
        ports: Sequence[int],
        computers: Sequence[Computer] = (),
        publishers: Mapping[str, Sequence[str]] | None = None,
        servers: Mapping[str, Sequence[str]] | None = None,
    ) -> None:
        """Of several computers, or of this one, on a port of some; topics and services may be granted to owners."""
        self.file, self.keys, self.owners = folder / "network.json", folder / "keys", folder / "owners"
        policy = bifrost.AccessPolicy(self.owners, publishers or {}, servers or {}) if publishers or servers else None
        if computers:
            self.network = bifrost.Network.create_for(computers, self.file, self.keys, policy)
        else:
            self.network = bifrost.Network.create(self.file, self.keys, ports=ports, policy=policy)
        self.log = folder / "bifrostd.log"
        self.daemons: dict[str, subprocess.Popen[bytes]] = {}
        self.within: dict[str, Sequence[str]] = {}  # by computer: the command that runs another one there
        self._nodes: list[bifrost.Node] = []
        self._peers: list[Peer] = []

    def environment(self, computer: str | None = None) -> dict[str, str]:
        """With which a process joins, on one of the computers (by default the first)."""
        return os.environ | {
            "BIFROST_NETWORK": str(self.file),
            "BIFROST_KEYS": str(self.keys),
            "BIFROST_OWNERS": str(self.owners),
            "BIFROST_COMPUTER": computer or self.network.computer.name,
            "OPENBLAS_NUM_THREADS": "1",
        }

    def on(self, computer: str | None = None, owner: str = "") -> bifrost.Network:
        """The network as one of the computers sees it, and an owner of a topic, or a member."""
        own_key = own_key_file(self.owners, owner) if owner else None
        return bifrost.Network.load(self.file, self.keys, computer or self.network.computer.name, own_key)

    @property
    def daemon(self) -> subprocess.Popen[bytes]:
        """That of the first computer."""
        return self.daemons[self.network.computer.name]

    def start_daemon(self, computer: str | None = None) -> subprocess.Popen[bytes]:
        """Start it, and wait until it answers."""
        network = self.on(computer)
        with open(self.log, "ab") as log:
            daemon = subprocess.Popen(
                [*self._within(computer), sys.executable, "-m", "bifrost.daemon"],
                env=self.environment(computer),
                stderr=log,
            )
        self.daemons[network.computer.name] = daemon
        if not self.within:
            until(lambda: bifrost.daemon_alive(network, 0.5), "the daemon answers", 20.0)
        return daemon

    def _within(self, computer: str | None) -> Sequence[str]:
        return self.within.get(computer or self.network.computer.name, ())

    def kill_daemon(self, computer: str | None = None) -> None:
        """SIGKILL, and wait."""
        daemon = self.daemons.pop(computer or self.network.computer.name)
        daemon.kill()
        daemon.wait()

    def node(self, name: str, computer: str | None = None, owner: str = "") -> bifrost.Node:
        """A node in this process, closed with the network."""
        return self.node_in(self.on(computer, owner), name)

    def node_in(self, network: bifrost.Network, name: str, recall: bool = False) -> bifrost.Node:
        """The same, in the network as the node itself sees it."""
        self._nodes.append(bifrost.Node(name, network=network, recall=recall))
        return self._nodes[-1]

    def peer(self, *arguments: str, computer: str | None = None) -> Peer:
        """A process that has its publisher, subscriber or server; killed with the network."""
        self._peers.append(Peer(self.environment(computer), *arguments, within=self._within(computer)))
        return self._peers[-1]

    def dismiss(self) -> None:
        """End the nodes and peers; the daemons go on, and know nobody then."""
        self._end_members()
        for computer in self.daemons:
            until(functools.partial(self._nobody, computer), f"the daemon of {computer} knows nobody", 20.0)

    def _end_members(self) -> None:
        for node in self._nodes:
            node.close()
        for peer in self._peers:
            if peer.alive():
                peer.kill()
        self._nodes.clear()
        self._peers.clear()

    def _nobody(self, computer: str) -> bool:
        info = bifrost.daemon_alive(self.on(computer), 5.0)
        assert info is not None, self.log.read_text()
        return info.nodes == 0

    def close(self) -> None:
        """End everything."""
        self._end_members()
        for daemon in self.daemons.values():
            daemon.terminate()
        for daemon in self.daemons.values():
            assert daemon.wait(10) == 0, self.log.read_text()


def connected(publisher: bifrost.Publisher[Sample], *subscribers: bifrost.Subscriber[Sample]) -> int:
    """Publish until every subscriber has had a message, empty them; returns the sequence reached."""
    sequence = 0
    reached = dict.fromkeys(subscribers, 0)

    def all_have() -> bool:
        nonlocal sequence
        sequence = publisher.publish(sample(0))
        for subscriber, last in reached.items():
            if not last and (received := subscriber.receive(timeout=0.02)) is not None:
                reached[subscriber] = received.sequence
        return all(reached.values())

    until(all_have, "every subscriber has had a message")
    for subscriber, last in reached.items():
        while last < sequence:
            received = subscriber.receive(timeout=60.0)
            assert received is not None
            last = received.sequence  # noqa: PLW2901
    return sequence


def sequences(subscriber: bifrost.Subscriber[Sample], last: int) -> list[int]:
    """The sequences of all messages that come, up to one."""
    came: list[int] = []
    while not came or came[-1] < last:
        received = subscriber.receive(timeout=60.0)
        assert received is not None
        came.append(received.sequence)
    return came
