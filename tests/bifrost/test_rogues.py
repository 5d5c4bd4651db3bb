"""A member that sends what no publisher would: whatever it is, it is delivered whole or refused."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
import zmq
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

import bifrost
from bifrost import wire
from bifrost.directory import Entry
from harness.bifrost_network import (
    BifrostNetwork,
    Sample,
    sample,
    until,
)
from harness.examples import examples


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
        """Topic and envelope, right unless told otherwise; the origin follows, and the payload."""
        if sequence is None:
            self._sequence += 1
            sequence = self._sequence
        now = time.monotonic_ns() if stamp is None else stamp
        return b"lab/sample\0" + wire.PUBLICATION.pack(wire.VERSION, schema, incarnation, sequence, now, length)

    def send(self, frame: bytes) -> None:
        """To all that subscribe."""
        self.socket.send(frame)

    def say(self, count: int, **envelope: int) -> None:
        """A message."""
        self.send(self.header(**envelope) + bifrost.codec(Sample).encode(sample(count)))  # type: ignore[arg-type]

    def heard_by(self, subscriber: bifrost.Subscriber[Sample]) -> None:
        """Speak until the subscriber hears it."""

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


def test_whatever_a_member_sends_is_delivered_whole_or_refused(net: BifrostNetwork, rogue: Rogue) -> None:
    subscriber = net.node("test").subscriber("lab/sample", Sample, queue=1000)
    codec = bifrost.codec(Sample)
    payload = codec.encode(sample(5))
    topic = b"lab/sample\0"
    rogue.heard_by(subscriber)

    def sent_and_received(frame: bytes) -> list[bifrost.Received[Sample]]:
        """What the subscriber makes of a frame, and of a good one behind it."""
        rogue.send(frame)
        rogue.say(3, incarnation=8)
        received: list[Any] = []
        while not received or received[-1].message != sample(3):
            one = subscriber.receive(timeout=60.0)
            assert one is not None, "the good one never came"
            received.append(one)
        return received[:-1]

    @examples(150, *HealthCheck)
    @given(data=st.data())
    def attack(data: st.DataObject) -> None:
        kind = data.draw(st.sampled_from(["noise", "cut", "flip", "payload", "header"]))
        # Each of an incarnation of its own: a flipped bit may make a sequence behind which no other comes.
        header = rogue.header(incarnation=data.draw(st.integers(10, 2**64 - 1)), length=5) + b"rogue"
        intact = header + payload
        if kind == "noise":
            frame = topic + data.draw(st.binary(min_size=1, max_size=200))
        elif kind == "cut":
            frame = intact[: data.draw(st.integers(len(topic) + 1, len(intact) - 1))]
        elif kind == "flip":
            position = data.draw(st.integers(len(topic), len(intact) - 1))
            frame = (
                intact[:position] + bytes([intact[position] ^ data.draw(st.integers(1, 255))]) + intact[position + 1 :]
            )
        elif kind == "payload":
            frame = header + data.draw(st.binary(max_size=300))
        else:
            frame = topic + data.draw(st.binary(min_size=34, max_size=34)) + b"rogue" + payload
        refused = subscriber.rejected
        others = sent_and_received(frame)
        assert len(others) + subscriber.rejected - refused == 1
        for one in others:  # a flipped bit may make another valid message: it is one of the type all the same
            assert isinstance(one.message, Sample)
            assert codec.decode(codec.encode(one.message)) == one.message

    attack()
    assert subscriber.rejected > 0


def test_well_framed_nonsense_is_refused_and_counted(net: BifrostNetwork, rogue: Rogue) -> None:
    subscriber = net.node("test").subscriber("lab/sample", Sample, queue=1000)
    rogue.heard_by(subscriber)
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
        received = subscriber.receive(timeout=60.0)
        assert received is not None
        counts.append(received.message.count)
    assert counts == [4]
    assert subscriber.rejected - refused >= len(nonsense)


def test_an_array_cut_short_is_refused(net: BifrostNetwork, rogue: Rogue) -> None:
    subscriber = net.node("test").subscriber("lab/sample", Sample, queue=10)
    rogue.heard_by(subscriber)
    refused = subscriber.rejected
    rogue.send(rogue.header() + bytes([0x94, 1, 0xA0, 0xC4, 7]) + bytes(7) + bytes([0xC4, 0]))
    rogue.send(rogue.header() + bytes([0x94, 1, 0xA0, 0xC4, 8]) + bytes(8) + bytes([0xC4, 0]))
    received = subscriber.receive(timeout=60.0)
    assert received is not None and received.message.values.tolist() == [0.0]
    assert received.origin == ""
    assert subscriber.rejected == refused + 1
