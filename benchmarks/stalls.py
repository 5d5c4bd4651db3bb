"""Does a process live through all that its connections can? Rounds of stall, kill and reconnection; then garbage.

Real processes on a network of their own. In a round a subscriber with a short queue reads nothing for a while, then a
few messages a second, while its publisher goes on, is killed and started again, or is stopped; at last it reads
everything, and must hear the publisher that runs then. Servers leave requests unanswered whose clients are killed.
Then files of bytes, such as libzmq's published fuzz corpora, whole, in pieces and altered, at every listening port.
Exit status 1 if any process has ended by itself.

    .venv/bin/python benchmarks/stalls.py [--rounds 1000] [--seed 0] [--corpus FOLDER] [--alterations 200]
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import os
import random
import signal
import socket as sockets
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import zmq

import bifrost
from harness.bifrost_network import Answer, BifrostNetwork, Question, Sample, ports, sample, until

TOPIC, SERVICE = "lab/load", "lab/ask"
READERS, EACH = 8, 5  # processes, and subscribers in each
QUEUE = 10
RATE = 500.0  # [Hz]
SIZE = 250  # numbers in a message, of 8 B
REQUESTS = 3000  # more than a server's socket holds
FATES = ("goes on", "killed at once", "killed late", "stopped")  # of the publisher, while its subscribers stall


class Process:
    """One of the processes below."""

    def __init__(self, net: BifrostNetwork, *role: str) -> None:
        self.name = role[0]
        self.process = subprocess.Popen(
            [sys.executable, __file__, "--role", *role],
            env=net.environment(), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert self.process.stdin is not None and self.process.stdout is not None
        self._in: IO[str] = self.process.stdin
        self._out: IO[str] = self.process.stdout

    def tell(self, line: str) -> None:
        """A command."""
        with contextlib.suppress(BrokenPipeError):
            self._in.write(line + "\n")
            self._in.flush()

    def hear(self) -> str:
        """Its answer; empty if it has ended."""
        return self._out.readline().strip()

    def end(self) -> None:
        """SIGKILL, and wait."""
        self.process.kill()
        self.process.wait()
        with contextlib.suppress(BrokenPipeError):
            self._in.close()
        self._out.close()


# --- the processes ----------------------------------------------------------------------------------------------------


def publish(generation: int) -> None:
    """Publish for ever."""
    with bifrost.Node("publisher") as node:
        publisher = node.publisher(TOPIC, Sample)
        print("ready", flush=True)
        due = time.monotonic()
        while True:
            publisher.publish(sample(generation, SIZE))
            due += 1.0 / RATE
            time.sleep(max(0.0, due - time.monotonic()))


def read(seed: int) -> None:
    """``SECONDS GENERATION``: stall so long, read slowly, then everything until that publisher is heard."""
    chance = random.Random(seed)
    with bifrost.Node("reader") as node:
        subscribers = [node.subscriber(TOPIC, Sample, queue=QUEUE) for _ in range(EACH)]
        print("ready", flush=True)
        for line in sys.stdin:
            seconds, generation = line.split()
            time.sleep(float(seconds))
            for _ in range(chance.randrange(4)):
                for subscriber in subscribers:
                    subscriber.receive(timeout=0.0)
                time.sleep(1.0 / chance.uniform(1.0, 10.0))
            heard = 0
            for subscriber in subscribers:
                deadline = time.monotonic() + 30.0
                while time.monotonic() < deadline:
                    received = subscriber.receive(timeout=1.0)
                    if received is not None and received.message.count == int(generation):
                        heard += 1
                        break
            print(heard, sum(subscriber.drops for subscriber in subscribers), flush=True)


def serve() -> None:
    """``SECONDS``: answer nothing for so long, then everything."""
    with bifrost.Node("server") as node:
        server = node.server(SERVICE, Question, Answer, lambda question, _: Answer(question.action, 0))
        print("ready", flush=True)
        for line in sys.stdin:
            time.sleep(float(line))
            while bifrost.wait([server], 0.5):
                server.serve()
            print("served", flush=True)


def ask() -> None:
    """Send requests nobody waits for, and wait to be killed."""
    with bifrost.Node("asker") as node:
        watch = node.discovery.watch("server", SERVICE)
        until(lambda: watch.peers, "a server is there")
        socket = node.discovery.connecting_socket(zmq.DEALER)
        socket.connect(watch.peers[-1].entry.endpoint)
        for _ in range(REQUESTS):
            with contextlib.suppress(zmq.Again):
                socket.send(SERVICE.encode() + bytes(1000), zmq.NOBLOCK)
        print("asked", flush=True)
        time.sleep(60.0)


# --- rounds -----------------------------------------------------------------------------------------------------------


class Rounds:
    """Starts the processes and counts how they end."""

    def __init__(self, net: BifrostNetwork, seed: int) -> None:
        self.net = net
        self.deaths: collections.Counter[str] = collections.Counter()
        self.rounds = self.deaf = self.drops = 0
        self._chance = random.Random(seed)
        self._generation = 0
        self._publisher = self._publish()
        self._readers = [self._start("read", str(seed + number)) for number in range(READERS)]
        self._server = self._start("serve")

    def batch(self) -> None:
        """Rounds of all subscribers at once, and one of the server."""
        fate = self._chance.choice(FATES)
        seconds = self._chance.uniform(1.0, 8.0)
        new = self._generation + fate.startswith("killed")
        for reader in self._readers:
            reader.tell(f"{seconds} {new}")
        self._server.tell(f"{seconds}")
        asker = Process(self.net, "ask")
        asker.hear()
        time.sleep(0.2 if fate == "killed at once" else 0.6 * seconds)
        asker.end()
        self._meet(fate)
        for index, reader in enumerate(self._readers):
            if answer := reader.hear():
                heard, drops = map(int, answer.split())
                self.rounds += heard
                self.deaf += EACH - heard
                self.drops += drops
            else:
                self._readers[index] = self._bury(reader, "read", str(index))
        if not self._server.hear():
            self._server = self._bury(self._server, "serve")

    def close(self) -> None:
        """End all."""
        for process in (*self._readers, self._server, self._publisher):
            process.end()

    def _meet(self, fate: str) -> None:
        if fate.startswith("killed"):
            self._publisher.end()
            self._generation += 1
            self._publisher = self._publish()
        elif fate == "stopped":
            self._publisher.process.send_signal(signal.SIGSTOP)
            time.sleep(self._chance.uniform(1.0, 7.0))
            self._publisher.process.send_signal(signal.SIGCONT)

    def _publish(self) -> Process:
        return self._start("publish", str(self._generation))

    def _start(self, *role: str) -> Process:
        process = Process(self.net, *role)
        assert process.hear() == "ready"
        return process

    def _bury(self, process: Process, *role: str) -> Process:
        status = process.process.wait()
        self.deaths[f"{process.name}: {signal.Signals(-status).name if status < 0 else status}"] += 1
        process.end()
        return self._start(*role)


def throw(port: int, content: bytes, chance: random.Random) -> None:
    """Send bytes to a port, in pieces or at once, and hang up, perhaps rudely."""
    with contextlib.suppress(OSError), sockets.create_connection(("127.0.0.1", port), timeout=5.0) as connection:
        connection.settimeout(0.05)
        at = 0
        while at < len(content):
            size = chance.choice((len(content), 1 + chance.randrange(200)))
            connection.sendall(content[at : at + size])
            at += size
            with contextlib.suppress(TimeoutError):
                connection.recv(4096)
        if chance.random() < 0.3:  # a reset in place of an end
            connection.setsockopt(sockets.SOL_SOCKET, sockets.SO_LINGER, b"\1\0\0\0\0\0\0\0")


def altered(content: bytes, chance: random.Random) -> bytes:
    """With some bytes flipped, gone, or more."""
    changed = bytearray(content)
    for _ in range(chance.randrange(1, 8)):
        at = chance.randrange(len(changed) + 1)
        changed[at : at + chance.randrange(3)] = chance.randbytes(chance.randrange(4))
    return bytes(changed)


def garbage(net: BifrostNetwork, folder: Path, alterations: int, seed: int) -> tuple[int, int]:
    """Throw every file, then altered ones, at all that listens; returns (times, processes that ended)."""
    files = [path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file() and ".git" not in path.parts]
    peers = [net.peer(role, topic, "10") for role, topic in (("publish", TOPIC), ("latch", "lab/latched"))]
    peers.append(net.peer("serve", SERVICE))
    processes: list[subprocess.Popen[Any]] = [net.daemon, *(peer.process for peer in peers)]
    targets = [port for process in processes for port in ports(process.pid)]
    chance = random.Random(seed)
    thrown = 0
    for content in [*files, *(altered(chance.choice(files), chance) for _ in range(alterations))]:
        for port in targets:
            throw(port, content, chance)
            thrown += 1
    subscriber = net.node("witness").subscriber(TOPIC, Sample)
    assert subscriber.receive(timeout=30.0) is not None  # what still runs still serves
    return thrown, sum(process.poll() is not None for process in processes)


def main() -> None:
    """Print what happened."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--corpus", type=Path)
    parser.add_argument("--alterations", type=int, default=200)
    parser.add_argument("--role", nargs="+", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.role:
        role, *arguments = options.role
        roles: dict[str, Callable[..., None]] = {"publish": publish, "read": read, "serve": serve, "ask": ask}
        roles[role](*map(int, arguments))
        return
    with tempfile.TemporaryDirectory() as folder:
        net = BifrostNetwork(Path(folder), range(20000, 30000))
        net.start_daemon()
        bad = 0
        try:
            if options.rounds:
                rounds = Rounds(net, options.seed)
                with contextlib.closing(rounds):
                    while rounds.rounds + rounds.deaf + EACH * rounds.deaths.total() < options.rounds:
                        rounds.batch()
                        print(f"{rounds.rounds} rounds, {dict(rounds.deaths)}", file=sys.stderr, flush=True)
                bad += rounds.deaths.total() + rounds.deaf
                print(f"{rounds.rounds} rounds; never heard again: {rounds.deaf}; processes that ended by themselves: "
                      f"{dict(rounds.deaths) or 'none'}; load {os.getloadavg()[0]:.1f}")  # fmt: skip
            if options.corpus:
                thrown, ended = garbage(net, options.corpus, options.alterations, options.seed)
                bad += ended
                print(f"{thrown} connections of garbage; processes that ended by themselves: {ended or 'none'}")
        finally:
            net.close()
    sys.exit(bad > 0)


if __name__ == "__main__":
    main()
