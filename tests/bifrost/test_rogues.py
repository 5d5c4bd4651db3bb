"""Invalid messages of a member are rejected and counted."""

import time
from collections.abc import Iterator

import msgspec
import pytest
import zmq

import bifrost
from bifrost import directory, wire
from bifrost.directory import Entry, NodeRecord
from harness.bifrost_network import Answer, BifrostNetwork, Question, Sample, sample, until
from harness.waiting import PATIENCE, some


class Rogue:
    """A member of the network that publishes bytes of its own making under the right topic and type."""

    def __init__(self, network: BifrostNetwork) -> None:
        self.node = network.node("rogue")
        self.socket = self.node.discovery.listening_socket(zmq.PUB)
        self.socket.bind("tcp://127.0.0.1:*")
        codec = bifrost.codec(Sample)
        endpoint = self.socket.getsockopt_string(zmq.LAST_ENDPOINT)
        self.node.discovery.announce(
            Entry("publisher", "lab/sample", ("Sample",), (codec.hash.hex(),), endpoint), [codec.schema]
        )
        self._sequence = 0

    def header(
        self,
        sequence: int | None = None,
        stamp: int | None = None,
        incarnation: int = 7,
        schema: bytes = bifrost.codec(Sample).hash,
        length: int = 0,
    ) -> bytes:
        """Topic and envelope, right unless given otherwise; the origin follows, and the payload."""
        if sequence is None:
            self._sequence += 1
            sequence = self._sequence
        now = time.monotonic_ns() if stamp is None else stamp
        return b"lab/sample\0" + wire.PUBLICATION.pack(wire.VERSION, schema, incarnation, sequence, now, length)

    def send(self, frame: bytes) -> None:
        self.socket.send(frame)

    def say(self, count: int, **envelope: int) -> None:
        self.send(self.header(**envelope) + bifrost.codec(Sample).encode(sample(count)))  # type: ignore[arg-type]

    def received_by(self, subscriber: bifrost.Subscriber[Sample]) -> None:
        def arrived() -> bool:
            self.say(1)
            return subscriber.receive(timeout=0.05) is not None

        until(arrived, "the subscriber hears the rogue")
        self.say(2)
        while (one := subscriber.receive(timeout=60.0)) and one.message.count != 2:
            pass


@pytest.fixture
def rogue(net: BifrostNetwork) -> Iterator[Rogue]:
    made = Rogue(net)
    yield made
    made.socket.close()


def test_invalid_frames_are_rejected_and_counted(net: BifrostNetwork, rogue: Rogue) -> None:
    subscriber = net.node("test").subscriber("lab/sample", Sample, queue=1000)
    rogue.received_by(subscriber)
    codec = bifrost.codec(Sample)
    payload = codec.encode(sample(5))
    fields = msgspec.msgpack.decode(payload)
    now = time.monotonic_ns()
    rogue.say(1, incarnation=20, sequence=10, stamp=now)
    received = subscriber.receive(timeout=60.0)
    assert received is not None and received.sequence == 10
    refused = subscriber.rejected
    nonsense = {
        "sequence of nought": rogue.header(sequence=0, incarnation=21) + payload,
        "sequence again": rogue.header(sequence=10, incarnation=20) + payload,
        "sequence backwards": rogue.header(sequence=9, incarnation=20) + payload,
        "stamp backwards": rogue.header(sequence=11, incarnation=20, stamp=now - 1) + payload,
        "stamp of the future": rogue.header(incarnation=22, stamp=now + 10**12) + payload,
        "another schema": rogue.header(schema=b"12345678") + payload,
        "origin longer than the message": rogue.header(length=255) + payload,
        "origin that is no text": rogue.header(length=2) + b"\xff\xff" + payload,
        "no payload": rogue.header(),
        "10 MB": rogue.header() + bytes(10_000_000),
        "deep nesting": rogue.header() + b"\x91" * 100_000,
        "a length that lies": rogue.header() + b"\xdd\xff\xff\xff\xff",
        "bytes of a length that lies": rogue.header() + b"\x94\x01\xa0\xc6\xff\xff\xff\xff\xc4\x00",
        "a map": rogue.header() + msgspec.msgpack.encode({"count": 1}),
        "keys twice": rogue.header() + b"\x82\xa1a\x01\xa1a\x02",
        "a field too few": rogue.header() + msgspec.msgpack.encode(fields[:-1]),
        "a field too many": rogue.header() + msgspec.msgpack.encode([*fields, 1]),
        "a number for text": rogue.header() + msgspec.msgpack.encode([1, 2, *fields[2:]]),
    }
    for frame in nonsense.values():
        rogue.send(frame)
    for parts in ([b""], [b"lab/sample"], [b"lab/sample\0"] * 40, [b"lab/sample\0" + bytes(5)] * 40):
        rogue.socket.send_multipart(parts)
    rogue.say(4)
    counts: list[int] = []
    while not counts or counts[-1] != 4:
        received = some(subscriber.receive(timeout=60.0))
        counts.append(received.message.count)
    assert counts == [4]
    assert subscriber.rejected - refused >= len(nonsense)


def test_a_server_rejects_and_counts_invalid_requests(net: BifrostNetwork) -> None:
    handled: list[Question] = []

    def handle(question: Question, origin: str) -> Answer:
        handled.append(question)
        return Answer(origin, len(handled))

    server = net.node("server").server("lab/ask", Question, Answer, handle)
    rogue = net.node("rogue").discovery.connecting_socket(zmq.DEALER)
    rogue.connect(server.socket.getsockopt_string(zmq.LAST_ENDPOINT))
    question, answer = bifrost.codec(Question), bifrost.codec(Answer)

    def request(payload: bytes, *, deadline: float = 60.0, topic: bytes = b"lab/ask", length: int = 5) -> bytes:
        ends = time.monotonic_ns() + int(deadline * 1e9)
        header = wire.REQUEST.pack(
            wire.VERSION, question.hash, answer.hash, 7, wire.computer_id(), ends, length
        )  # fmt: skip
        return topic + b"\0" + header + b"rogue" + payload

    good = question.encode(Question("open", 1.0))
    nonsense: dict[str, list[bytes]] = {
        "an empty part": [b""],
        "40 parts": [request(good)] * 40,
        "an empty topic": [request(good, topic=b"")],
        "another topic": [request(good, topic=b"lab/other")],
        "10 MB": [request(bytes(10_000_000))],
        "deep nesting": [request(b"\x91" * 100_000)],
        "a length that lies": [request(b"\x92\xdb\xff\xff\xff\xffx")],
        "an array's length that lies": [request(b"\xdd\xff\xff\xff\xff")],
        "keys twice": [request(b"\x82\xa1a\x01\xa1a\x02")],
        "a field too many": [request(msgspec.msgpack.encode(["open", 1.0, 1]))],
        "a stale deadline": [request(good, deadline=-1.0)],
        "an origin longer than the request": [request(b"", length=255)],
        "another version": [request(good).replace(b"lab/ask\0\x01", b"lab/ask\0\x02")],
        "another type": [request(good).replace(answer.hash, bytes(8))],
    }
    for parts in nonsense.values():
        rogue.send_multipart(parts)
    rogue.send(request(question.encode(Question("open", float("nan")))))  # a value
    replies: list[bytes] = []
    deadline = time.monotonic() + PATIENCE
    while not handled and time.monotonic() < deadline:
        bifrost.wait([server], timeout=1.0)
        server.serve()
        while rogue.poll(0):
            replies.append(rogue.recv())
    while rogue.poll(500):
        replies.append(rogue.recv())
    rogue.close()
    assert [q.action for q in handled] == ["open"]
    assert server.rejected == len(nonsense)
    status = {reply[wire.REPLY.size :]: wire.REPLY.unpack_from(reply)[2] for reply in replies}
    assert [*status.values()][-1] == wire.OK and [*status.values()].count(wire.OK) == 1
    assert status[b"lab/ask"] == wire.OTHER_TOPIC
    [other] = [text.decode() for text, each in status.items() if each == wire.OTHER_SCHEMA]
    assert "server serves Question" in other and "rogue asked with" in other


def test_the_daemon_rejects_and_counts_invalid_messages(own_net: BifrostNetwork) -> None:
    node = own_net.node("rogue")
    rogue = node.discovery.connecting_socket(zmq.DEALER)
    rogue.connect(own_net.network.computer.daemon)
    before = set(node.graph(10.0).nodes)
    register = msgspec.to_builtins(directory.Register(NodeRecord("ghost", 1, 2, "localhost", 3)))
    nonsense: list[list[bytes]] = [
        [b""],
        [b"x"] * 40,
        [bytes(10_000_000)],
        [b"\x91" * 100_000],
        [b"\xdf\xff\xff\xff\xff"],
        [b"\x81\xa4type\xdb\xff\xff\xff\xff"],
        [msgspec.msgpack.encode({"type": "unheard_of"})],
        [msgspec.msgpack.encode({"type": "heartbeat", "incarnation": "1", "epoch": 0, "version": 0})],
        [msgspec.msgpack.encode({"type": "heartbeat", "incarnation": 2**70 % 2**64, "epoch": None, "version": 0})],
        [msgspec.msgpack.encode(register | {"node": register["node"] | {"name": float("nan")}})],
        [msgspec.msgpack.encode(register | {"node": register["node"] | {"entries": [{"kind": "king"}]}})],
    ]
    for parts in nonsense:
        rogue.send_multipart(parts)

    def counted() -> bool:
        info = bifrost.daemon_alive(own_net.network, 5.0)
        return info is not None and info.refused == len(nonsense)

    until(counted, "all are refused", 20.0)
    rogue.close()
    assert set(node.graph(10.0).nodes) == before
    with bifrost.Node("newcomer", network=own_net.network) as newcomer:
        assert "rogue" in newcomer.graph(10.0).nodes
