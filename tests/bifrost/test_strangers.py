"""Processes without keys at all ports: mutated handshakes, replays, resets, silent connections."""

import contextlib
import random
import socket as sockets
import struct
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import psutil
import pytest
import zmq

import bifrost
from harness.bifrost_network import Answer, BifrostNetwork, Peer, Question, Sample, mechanism, ports, until
from valor.valorctl.instance.ros_domain import daemon_ports

GREETING = 64  # [B], of ZMTP 3
WELCOME = 170  # [B], the answer to a HELLO, framed
PATIENCE = 10.0  # [s]; on a quiet machine an honest newcomer is served within a few hundredths
MEMORY = 16.0  # [MiB] that an attack may leave behind: heaps keep some of what they once had


class Tap:
    """A proxy before a port that records what clients send."""

    def __init__(self, port: int) -> None:
        self.said = bytearray()
        self.answered = 0  # bytes that came back
        self._target = port
        self._listener = sockets.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp://127.0.0.1:{self._listener.getsockname()[1]}"
        self._open: list[sockets.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = self._listener.accept()
                server = sockets.create_connection(("127.0.0.1", self._target))
                self._open += [client, server]
                threading.Thread(target=self._forward, args=(client, server), daemon=True).start()
                threading.Thread(target=self._return, args=(server, client), daemon=True).start()

    def _forward(self, client: sockets.socket, server: sockets.socket) -> None:
        with contextlib.suppress(OSError):
            while part := client.recv(65536):
                self.said += part
                server.sendall(part)
            server.shutdown(sockets.SHUT_WR)

    def _return(self, server: sockets.socket, client: sockets.socket) -> None:
        with contextlib.suppress(OSError):
            while part := server.recv(65536):
                self.answered += len(part)
                client.sendall(part)
            client.shutdown(sockets.SHUT_WR)

    def close(self) -> None:
        self._listener.close()
        for each in self._open:
            with contextlib.suppress(OSError):  # it has ended
                each.shutdown(sockets.SHUT_RDWR)  # as in `reset`
            each.close()


def reset(connection: sockets.socket) -> None:
    """Close with RST."""
    connection.setsockopt(sockets.SOL_SOCKET, sockets.SO_LINGER, struct.pack("ii", 1, 0))
    with contextlib.suppress(OSError):  # it has ended
        connection.shutdown(sockets.SHUT_RD)  # a thread that waits for it would keep it open beyond its close
    connection.close()


@dataclass
class Party:
    """A network with one process of each kind, and members here who watch that they are served."""

    net: BifrostNetwork
    publisher: Peer
    server: Peer
    taps: list[Tap] = field(default_factory=list)

    def __post_init__(self) -> None:
        node = self.net.node("honest")
        self.subscriber = node.subscriber("lab/sample", Sample, queue=100_000)
        self.client = node.client("lab/ask", Question, Answer)
        first = self.subscriber.receive(timeout=20.0)
        assert first is not None
        self.last = first.sequence
        assert self.client.call(Question("open", 0.0), timeout=20.0)
        self.pids = (self.net.daemon.pid, self.publisher.pid, self.server.pid)
        self.ports = [port for pid in self.pids for port in ports(pid)]
        assert len(self.ports) == len(self.pids)
        self.assert_served()  # whatever is opened once, by the first newcomer, is open then
        self.settled = self._at_rest()

    def tap(self, port: int) -> Tap:
        self.taps.append(Tap(port))
        return self.taps[-1]

    def assert_served(self) -> None:
        """Every process lives; every message has come; a call is answered; a newcomer receives the publisher soon."""
        assert self.net.daemon.poll() is None and self.publisher.alive() and self.server.alive()
        for received in self.subscriber.drain():
            assert received.sequence == self.last + 1
            self.last = received.sequence
        assert self.client.call(Question("close", 0.0), timeout=PATIENCE).text == "close for honest"
        with bifrost.Node("newcomer", network=self.net.network) as newcomer:
            assert newcomer.subscriber("lab/sample", Sample).receive(timeout=PATIENCE) is not None

    def descriptors(self) -> list[int]:
        return [psutil.Process(pid).num_fds() for pid in self.pids]

    def _at_rest(self) -> list[int]:
        """Descriptors, once nothing comes or goes."""
        looks: list[list[int]] = []

        def still() -> bool:
            looks.append(self.descriptors())
            return len(looks) > 20 and all(look == looks[-1] for look in looks[-20:])

        until(still, "descriptors at rest", PATIENCE)
        return looks[-1]

    def memory(self) -> list[float]:
        """Of each process [MiB]."""
        return [psutil.Process(pid).memory_info().rss / 2**20 for pid in self.pids]

    @contextlib.contextmanager
    def nothing_grows(self) -> Iterator[None]:
        """Descriptors are closed and memory is freed after the block."""
        memory = self.memory()
        yield
        until(
            lambda: all(now <= then for now, then in zip(self.descriptors(), self.settled, strict=True)),
            f"descriptors are back to {self.settled}",
            40.0,
        )
        grown = [now - then for now, then in zip(self.memory(), memory, strict=True)]
        assert max(grown) < MEMORY, f"memory grew by {grown} MiB"

    def record(self, kind: int, port: int, act: Callable[[zmq.Socket[bytes]], object]) -> bytes:
        """What a member reports on the wire when it does something."""
        tap = self.tap(port)
        with bifrost.Node("recorded", network=self.net.network) as node:
            socket = node.discovery.connecting_socket(kind)
            socket.connect(tap.endpoint)
            act(socket)
            socket.close()
        return bytes(tap.said)


@pytest.fixture(scope="module")
def party(tmp_path_factory: pytest.TempPathFactory, ros_domain: int) -> Iterator[Party]:
    net = BifrostNetwork(tmp_path_factory.mktemp("party"), daemon_ports(ros_domain))
    net.start_daemon()
    made = Party(net, net.peer("publish", "lab/sample", "100"), net.peer("serve", "lab/ask"))
    yield made
    for tap in made.taps:
        tap.close()
    net.close()


def listened(socket: zmq.Socket[bytes]) -> None:
    socket.setsockopt(zmq.SUBSCRIBE, b"lab/sample\0")
    assert socket.poll(10_000)


def split(said: bytes) -> list[bytes]:
    """The greeting and the frames of a ZMTP conversation, as sent."""
    parts, rest = [said[:GREETING]], said[GREETING:]
    while rest:
        header = 9 if rest[0] & 2 else 2
        length = header + int.from_bytes(rest[1:header], "big")
        parts.append(rest[:length])
        rest = rest[length:]
    return parts


def mutated(parts: list[bytes], chance: random.Random) -> bytes:
    """A conversation that is nearly right."""
    said = list(parts)
    for _ in range(chance.randint(1, 3)):
        index = chance.randrange(len(said))
        part = bytearray(said[index])
        match chance.randrange(8):
            case 0 if part:  # a few bits
                for _ in range(chance.randint(1, 8)):
                    part[chance.randrange(len(part))] ^= 1 << chance.randrange(8)
            case 1:  # the end is missing
                part = part[: chance.randrange(len(part) + 1)]
            case 2 if len(part) > 9:  # flags or a length that lies
                part[:9] = bytes([chance.randrange(8)]) + chance.randbytes(8)
            case 3 if len(part) > 12:  # another command
                name = chance.choice([b"HELLO", b"WELCOME", b"INITIATE", b"READY", b"ERROR", b"PING", b"MESSAGE", b""])
                part[2:] = bytes([len(name)]) + name + part[3 + len(name) :]
            case 4:  # too much
                part += chance.randbytes(chance.randint(1, 2000))
            case 5:  # something else
                part = bytearray(chance.randbytes(chance.randint(1, 300)))
            case 6:  # out of turn
                chance.shuffle(said)
                continue
            case _:  # once more
                said.insert(index, said[index])
                continue
        said[index] = bytes(part)
    return b"".join(said)


def test_thousands_of_mutated_handshakes_and_commands(party: Party) -> None:
    _, publishing, serving = party.ports
    question = b"lab/ask\0" + bytes(64)
    conversations = [
        split(party.record(zmq.SUB, publishing, listened)),
        split(party.record(zmq.DEALER, serving, lambda socket: (socket.send(question), socket.poll(300)))),
    ]
    assert all(len(parts) >= 4 for parts in conversations)  # greeting, HELLO, INITIATE, MESSAGE
    chance = random.Random(0)

    def attack(times: int) -> None:
        for number in range(times):
            port = party.ports[number % len(party.ports)]
            connection = sockets.create_connection(("127.0.0.1", port), timeout=5.0)
            with contextlib.suppress(OSError):
                connection.sendall(mutated(chance.choice(conversations), chance))
            if number % 50 == 0:
                connection.settimeout(0.05)
                with contextlib.suppress(OSError):
                    answer = connection.recv(4096)
                    assert len(answer) <= GREETING + WELCOME + 100 and answer[12:32].rstrip(b"\0") in (b"CURVE", b"")
            if chance.random() < 0.3:
                reset(connection)
            else:
                connection.close()

    attack(300)  # heaps grow to what such a crowd takes
    with party.nothing_grows():
        attack(2700)
        party.assert_served()


def test_connections_that_say_nothing_or_half_a_greeting(party: Party) -> None:
    greeting = party.record(zmq.SUB, party.ports[1], listened)[:GREETING]
    with party.nothing_grows():
        idle = [sockets.create_connection(("127.0.0.1", party.ports[i % 3])) for i in range(300)]
        for number, connection in enumerate(idle):
            connection.sendall(greeting[: (0, 7, 11, GREETING)[number % 4]])
        party.assert_served()
        # They are hung up on; only then do we let go.
        for connection in idle:
            connection.settimeout(20.0)
            with contextlib.suppress(ConnectionError):
                while connection.recv(4096):
                    pass
            connection.close()


def test_a_replayed_handshake_gets_nothing(party: Party) -> None:
    """All that a member said once, word for word: the cookie in it was for that connection alone."""
    publishing = party.ports[1]

    def hear(socket: zmq.Socket[bytes]) -> None:
        listened(socket)
        socket.recv()

    said = split(party.record(zmq.SUB, publishing, hear))
    assert party.taps[-1].answered > GREETING + WELCOME + 500  # it has received messages
    for port in party.ports:
        with sockets.create_connection(("127.0.0.1", port), timeout=5.0) as connection:
            answer = b""
            with contextlib.suppress(OSError):
                for part, expected in zip(said, (GREETING, GREETING + WELCOME), strict=False):
                    connection.sendall(part)
                    while len(answer) < expected:
                        answer += connection.recv(4096) or b""
                connection.settimeout(1.0)
                connection.sendall(b"".join(said[2:]))
                while more := connection.recv(4096):
                    answer += more
            assert len(answer) >= GREETING + WELCOME  # it was listened to so far
            assert len(answer) <= GREETING + WELCOME + 64 and b"READY" not in answer
    party.assert_served()


def test_no_port_of_a_node_or_daemon_is_without_curve(party: Party) -> None:
    """libzmq 4.3.5 ends the process on certain bytes sent to a socket without security."""
    latch = party.net.peer("latch", "lab/latched", "10")
    every = [*party.ports, *ports(latch.pid)]
    assert [mechanism(port) for port in every] == ["CURVE"] * len(every)
    latch.kill()  # its connection is no stranger's: whatever test comes next, nothing has grown
