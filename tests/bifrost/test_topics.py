"""Publish and subscribe across real processes."""

from __future__ import annotations

import os
import selectors
import signal
import socket as sockets
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
import psutil
import pytest
import zmq
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

import bifrost
from bifrost import wire
from bifrost.directory import Entry
from harness.bifrost_network import (
    BifrostNetwork,
    Peer,
    Sample,
    connected,
    sample,
    sequences,
    until,
)
from harness.examples import examples


class Other(bifrost.Message):
    """Another type for the same topic."""

    count: float


def test_messages_of_another_process_arrive_whole_and_in_order(net: BifrostNetwork) -> None:
    net.peer("publish", "lab/sample", "200")
    subscriber = net.node("test").subscriber("lab/sample", Sample, queue=1000)
    received = [subscriber.receive(timeout=60.0) for _ in range(100)]
    assert all(r is not None for r in received)
    sequences = [r.sequence for r in received if r]
    assert sequences == list(range(sequences[0], sequences[0] + 100))
    stamps = [r.stamp for r in received if r]
    assert stamps == sorted(stamps)
    assert stamps[-1] <= time.monotonic_ns()
    for r in received:
        assert r is not None
        assert r.origin == "publish_peer"
        assert r.message == sample(r.message.count)
        assert not r.message.values.flags.writeable
        assert r.message.values.flags.aligned
    assert (subscriber.drops, subscriber.rejected) == (0, 0)


@pytest.mark.parametrize("order", ["daemon publisher subscriber", "subscriber publisher daemon",
                                   "publisher subscriber daemon"])  # fmt: skip
def test_any_order_of_arrival(bare_network: BifrostNetwork, order: str) -> None:
    subscriber: bifrost.Subscriber[Sample] | None = None
    for what in order.split():
        if what == "daemon":
            bare_network.start_daemon()
        elif what == "publisher":
            bare_network.peer("publish", "lab/sample", "100")
        else:
            subscriber = bare_network.node("test").subscriber("lab/sample", Sample)
    assert subscriber is not None
    assert subscriber.receive(timeout=60.0) is not None


def test_latest_gives_the_newest_and_queue_gives_all(net: BifrostNetwork) -> None:
    node, other = net.node("publisher"), net.node("subscriber")
    publisher = node.publisher("lab/sample", Sample)
    latest = other.subscriber("lab/sample", Sample)
    queue = other.subscriber("lab/sample", Sample, queue=1000)
    first = connected(publisher, latest, queue)
    for count in range(1, 101):
        last = publisher.publish(sample(count))
    everything = []
    until(lambda: everything.extend(queue.drain()) or len(everything) == 100, "a hundred messages")  # type: ignore[func-returns-value]
    assert [r.sequence for r in everything] == list(range(first + 1, last + 1))
    newest = until(lambda: (r := latest.latest()) and r.sequence == last and r, "the newest")
    assert newest.message == sample(100)
    assert latest.latest() is None
    assert latest.receive(timeout=0.0) is None
    assert latest.receive(timeout=0.05) is None
    assert latest.drain() == []
    assert (queue.drops, latest.drops) == (0, 0)


def test_what_a_queue_cannot_hold_is_counted(net: BifrostNetwork) -> None:
    publisher = net.node("publisher").publisher("lab/sample", Sample)
    subscriber = net.node("subscriber").subscriber("lab/sample", Sample, queue=10)
    first = connected(publisher, subscriber)
    large = sample(1, size=4000)
    for _ in range(6000):
        publisher.publish(large)
    received = 0

    def drained() -> bool:
        nonlocal received, last
        last = publisher.publish(sample(2))
        for r in subscriber.drain():
            received += 1
            if r.sequence == last:
                return True
        return False

    last = 0
    until(drained, "the message after the flood")
    assert subscriber.drops > 0
    assert received + subscriber.drops == last - first


def test_a_killed_publisher_is_replaced_without_a_gap(net: BifrostNetwork) -> None:
    peer = net.peer("publish", "lab/sample", "200")
    subscriber = net.node("test").subscriber("lab/sample", Sample, queue=1000)
    for _ in range(20):
        assert subscriber.receive(timeout=60.0) is not None
    peer.kill()
    subscriber.drain()
    net.peer("publish", "lab/sample", "200")
    again = subscriber.receive(timeout=60.0)
    assert again is not None
    assert again.sequence < 100
    assert subscriber.drops == 0
    until(lambda: subscriber.drain() is not None and len(subscriber.publishers) == 1, "the dead one is let go")


def test_a_killed_publisher_is_known_to_be_gone_while_its_last_words_may_still_come(net: BifrostNetwork) -> None:
    peer = net.peer("publish", "lab/sample", "200")
    subscriber = net.node("test").subscriber("lab/sample", Sample, queue=1000)
    assert subscriber.receive(timeout=60.0) is not None
    assert len(subscriber.publishers) == 1
    peer.kill()
    until(lambda: not subscriber.publishers, "the killed publisher is gone", 5.0)  # before its connection is given up


def test_another_type_is_refused_and_both_are_named(net: BifrostNetwork) -> None:
    node = net.node("publisher")
    wrong, right = node.publisher("lab/sample", Other), node.publisher("lab/other", Sample)
    other = net.node("subscriber")
    refusing, accepting = other.subscriber("lab/sample", Sample, queue=9), other.subscriber("lab/other", Sample)
    connected(right, accepting)
    wrong.publish(Other(1.0))
    assert refusing.receive(timeout=0.2) is None
    [error] = until(lambda: refusing.drain() == [] and refusing.mismatches, "the mismatch is known")
    assert isinstance(error, bifrost.SchemaError)
    for word in ("lab/sample", "publisher", "subscriber", "Other", "Sample"):
        assert word in str(error)
    assert "\n" not in str(error)


def test_two_publishers_of_one_topic_and_two_threads_of_one_node(net: BifrostNetwork) -> None:
    node = net.node("publisher")
    publishers = [node.publisher("lab/sample", Sample) for _ in range(2)]
    subscriber = net.node("subscriber").subscriber("lab/sample", Sample, queue=10000)
    for publisher in publishers:
        connected(publisher, subscriber)

    def publish(publisher: bifrost.Publisher[Sample], first: int) -> None:
        for count in range(first, first + 300):
            publisher.publish(sample(count))

    threads = [threading.Thread(target=publish, args=(p, 1000 * i)) for i, p in enumerate(publishers)]
    for thread in threads:
        thread.start()
    received = [subscriber.receive(timeout=60.0) for _ in range(600)]
    for thread in threads:
        thread.join()
    counts = [r.message.count for r in received if r]
    assert sorted(counts) == [*range(300), *range(1000, 1300)]
    assert [c for c in counts if c < 1000] == list(range(300))
    assert subscriber.drops == 0


def test_no_wake_up_is_ever_lost(net: BifrostNetwork) -> None:
    """Ping-pong: each side answers only when woken; a lost wake-up would end it."""
    ping_node, pong_node = net.node("ping"), net.node("pong")
    ping, pong = ping_node.publisher("lab/ping", Sample), pong_node.publisher("lab/pong", Sample)
    heard_ping = pong_node.subscriber("lab/ping", Sample)
    heard_pong = ping_node.subscriber("lab/pong", Sample)
    connected(ping, heard_ping)
    connected(pong, heard_pong)
    rounds = 2000
    failures: list[int] = []

    def answer() -> None:
        for count in range(rounds):
            if not (bifrost.wait([heard_ping], timeout=5.0) and heard_ping.latest()):
                failures.append(count)
                return
            pong.publish(sample(count, 1))

    thread = threading.Thread(target=answer)
    thread.start()
    for count in range(rounds):
        ping.publish(sample(count, 1))
        received = heard_pong.receive(timeout=60.0)
        assert received is not None and received.message.count == count, f"round {count}, {failures}"
    thread.join()
    assert not failures


def test_wait_tells_who_has_something(net: BifrostNetwork) -> None:
    node = net.node("publisher")
    publishers = [node.publisher(f"lab/{i}", Sample) for i in range(3)]
    other = net.node("subscriber")
    subscribers = [other.subscriber(f"lab/{i}", Sample, queue=10) for i in range(3)]
    for publisher, subscriber in zip(publishers, subscribers, strict=True):
        connected(publisher, subscriber)
    assert bifrost.wait(subscribers, timeout=0.0) == []
    before = time.monotonic()
    assert bifrost.wait(subscribers, timeout=0.05) == []
    assert time.monotonic() - before >= 0.05
    publishers[1].publish(sample(1))
    assert bifrost.wait(subscribers, timeout=5.0) == [subscribers[1]]
    # It keeps saying so until the message is taken, and loses none by saying so.
    publishers[2].publish(sample(2))
    until(lambda: bifrost.wait(subscribers, timeout=0.1) == subscribers[1:], "both")
    assert [r.message.count for s in subscribers for r in s.drain()] == [1, 2]
    assert bifrost.wait(subscribers, timeout=0.0) == []


@pytest.mark.parametrize(("queue", "drop"), [(None, "newest"), (10, "newest"), (10, "oldest")])
def test_a_wait_is_ended_from_another_thread_and_no_message_is_lost_by_it(
    net: BifrostNetwork, queue: int | None, drop: Literal["newest", "oldest"]
) -> None:
    publisher = net.node("publisher").publisher("lab/sample", Sample)
    subscriber = net.node("subscriber").subscriber("lab/sample", Sample, queue, drop)
    connected(publisher, subscriber)
    subscriber.receive(timeout=0.0)
    for count in range(3):
        waker = threading.Timer(0.1, subscriber.wake)
        waker.start()
        before = time.monotonic()
        assert subscriber.receive(timeout=20.0) is None
        assert time.monotonic() - before < 10.0
        waker.join()
        publisher.publish(sample(count))
        received = subscriber.receive(timeout=60.0)
        assert received is not None and received.message.count == count
    # Woken while a message waits: either comes first, and neither keeps the next message from being heard.
    publisher.publish(sample(7))
    assert bifrost.wait([subscriber], timeout=5.0) == [subscriber]
    subscriber.wake()
    until(lambda: (heard := subscriber.receive(timeout=60.0)) is not None and heard.message.count == 7, "the message")
    publisher.publish(sample(8))
    until(lambda: (heard := subscriber.receive(timeout=60.0)) is not None and heard.message.count == 8, "the message")
    assert (subscriber.drops, subscriber.rejected) == (0, 0)


def test_a_poller_tells_once_of_each_that_may_have_something(net: BifrostNetwork) -> None:
    publishing, subscribing = net.node("publishing"), net.node("subscribing")
    publishers = [publishing.publisher(f"lab/{name}", Sample) for name in ("a", "b")]
    subscribers = [subscribing.subscriber(f"lab/{name}", Sample, queue=100) for name in ("a", "b")]
    server = subscribing.server("lab/serve", Sample, Sample, lambda request, origin: request)
    for publisher, subscriber in zip(publishers, subscribers, strict=True):
        connected(publisher, subscriber)
    poller = bifrost.Poller([*subscribers, server])
    try:
        assert poller.look() == [*subscribers, server]  # of what came before, nobody tells again
        server.serve()
        for subscriber in subscribers:
            subscriber.drain()
        until(lambda: poller.look() == [], "nothing more")
        publishers[1].publish(sample(1))
        until(lambda: poller.look() == [subscribers[1]], "the second")
        assert [received.message.count for received in subscribers[1].drain()] == [1]
        assert poller.look() == []
        publishers[0].publish(sample(2))
        answers = []
        client = publishing.client("lab/serve", Sample, Sample)
        asking = threading.Thread(target=lambda: answers.append(client.call(sample(3), timeout=20.0)))
        asking.start()
        taken = []

        def look() -> bool:
            for item in poller.look():
                if item is server:
                    server.serve()
                elif isinstance(item, bifrost.Subscriber):
                    taken.extend(received.message.count for received in item.drain())
            return taken == [2] and not asking.is_alive()

        until(look, "a message and a request")
        assert answers == [sample(3)]
    finally:
        poller.close()


def test_a_loop_that_drains_only_what_its_poller_tells_misses_nothing(net: BifrostNetwork) -> None:
    subscriber = net.node("subscribing").subscriber("lab/sample", Sample, queue=10_000)
    poller = bifrost.Poller([subscriber])
    publisher = net.node("publishing").publisher("lab/sample", Sample)
    connected(publisher, subscriber)
    poller.look()
    subscriber.drain()
    many, random = 2000, np.random.default_rng(0)

    def publish() -> None:
        for count in range(many):
            publisher.publish(sample(count))
            if random.random() < 0.3:  # single messages and bursts, while the loop reads and while it does not
                time.sleep(random.random() * 5e-4)

    publishing = threading.Thread(target=publish)
    publishing.start()
    taken: list[int] = []

    def look() -> bool:
        if poller.look():
            taken.extend(received.message.count for received in subscriber.drain())
        return len(taken) >= many

    until(look, "all", 60.0)
    publishing.join()
    poller.close()
    assert taken == list(range(many))


def test_a_subscriber_tells_how_far_its_publisher_has_counted(net: BifrostNetwork) -> None:
    publisher = net.node("publisher").publisher("lab/sample", Sample)
    node = net.node("subscriber")
    queue, newest = node.subscriber("lab/sample", Sample, queue=1000), node.subscriber("lab/sample", Sample)
    assert queue.sequence == newest.sequence == 0
    connected(publisher, queue, newest)
    for i in range(50):
        publisher.publish(sample(i))
    last = [queue.receive(timeout=10.0) for _ in range(50)][-1]
    assert last is not None and queue.sequence == last.sequence
    until(lambda: newest.latest() is not None and newest.sequence == last.sequence, "the newest has come")


def test_the_descriptor_serves_an_event_loop(net: BifrostNetwork) -> None:
    publisher = net.node("publisher").publisher("lab/sample", Sample)
    subscriber = net.node("subscriber").subscriber("lab/sample", Sample, queue=1000)
    connected(publisher, subscriber)
    counts: list[int] = []
    thread = threading.Thread(target=lambda: [publisher.publish(sample(i)) for i in range(200)])
    with selectors.DefaultSelector() as selector:
        selector.register(subscriber.fileno(), selectors.EVENT_READ)
        thread.start()
        counts += [r.message.count for r in subscriber.drain()]
        deadline = time.monotonic() + 10.0
        while len(counts) < 200 and time.monotonic() < deadline:
            selector.select(timeout=5.0)
            counts += [r.message.count for r in subscriber.drain()]
    thread.join()
    assert counts == list(range(200))


@pytest.mark.parametrize("queue", [None, 100])
def test_who_comes_late_gets_the_last_of_a_latched_publisher_once(net: BifrostNetwork, queue: int | None) -> None:
    publisher = net.node("publisher").publisher("lab/sample", Sample, latched=True)
    for count in range(5):
        publisher.publish(sample(count))
    late = net.node("late").subscriber("lab/sample", Sample, queue=queue)
    received = late.receive(timeout=60.0)
    assert received is not None and (received.sequence, received.message) == (5, sample(4))
    publisher.publish(sample(5))
    later = net.node("later").subscriber("lab/sample", Sample, queue=queue)
    anybody = net.node("anybody").subscribe_any("lab/sample", queue=queue)
    for subscriber in (late, later, anybody):
        received = subscriber.receive(timeout=60.0)
        assert received is not None and received.sequence == 6
    assert publisher.publish(sample(6)) == 7
    for subscriber in (late, later, anybody):
        received = subscriber.receive(timeout=60.0)
        assert received is not None and received.sequence == 7
        assert subscriber.receive(timeout=0.1) is None
        assert (subscriber.drops, subscriber.rejected) == (0, 0)
    publisher.close()
    assert net.node("too_late").subscriber("lab/sample", Sample).receive(timeout=0.3) is None


def test_latched_messages_are_neither_doubled_nor_disordered_by_coming_and_going(net: BifrostNetwork) -> None:
    """Subscribers join while a latched publisher is at full speed; each sees a rising sequence without a hole."""
    peer = net.peer("latch", "lab/sample", "500")
    node = net.node("test")
    for _ in range(20):
        subscriber = node.subscriber("lab/sample", Sample, queue=1000)
        received = [subscriber.receive(timeout=60.0) for _ in range(20)]
        sequences = [one.sequence for one in received if one]
        assert sequences == list(range(sequences[0], sequences[0] + 20))
        assert (subscriber.drops, subscriber.rejected) == (0, 0)
        subscriber.close()
    # A connection that breaks and is made again brings nothing twice.
    subscriber = node.subscriber("lab/sample", Sample, queue=1000)
    first = subscriber.receive(timeout=60.0)
    assert first is not None
    peer.signal(signal.SIGSTOP)
    while subscriber.receive(timeout=0.5):
        pass
    [connection] = [c for c in psutil.Process().net_connections("tcp") if c.raddr and c.raddr.port in listening(peer)]
    cut(connection.laddr.port, connection.raddr.port)
    peer.signal(signal.SIGCONT)
    last = first.sequence
    for _ in range(200):
        received_one = subscriber.receive(timeout=60.0)
        assert received_one is not None and received_one.sequence > last
        last = received_one.sequence
    assert subscriber.rejected == 0


def listening(peer: Peer) -> set[int]:
    """The TCP ports that a process listens on."""
    return {c.laddr.port for c in psutil.Process(peer.pid).net_connections("tcp") if c.status == psutil.CONN_LISTEN}


def cut(local: int, remote: int) -> None:
    """End a TCP connection of this process from below, as a broken network would."""
    for open_file in Path("/proc/self/fd").iterdir():
        if not open_file.is_socket():
            continue
        duplicate = sockets.socket(fileno=os.dup(int(open_file.name)))
        with duplicate:
            try:
                ends = duplicate.getsockname()[1], duplicate.getpeername()[1]
            except (OSError, IndexError):
                continue
            if ends == (local, remote):
                duplicate.shutdown(sockets.SHUT_RDWR)


@pytest.mark.parametrize(("drop", "kept"), [("oldest", list(range(190, 200))), ("newest", list(range(10)))])
def test_a_full_queue_drops_what_it_was_told_to(net: BifrostNetwork, drop: Any, kept: list[int]) -> None:
    publisher = net.node("publisher").publisher("lab/sample", Sample)
    subscriber = net.node("test").subscriber("lab/sample", Sample, queue=10, drop=drop)
    witness = net.node("witness").subscriber("lab/sample", Sample, queue=10_000)
    start = connected(publisher, subscriber, witness)
    for count in range(200):
        publisher.publish(sample(count))
    while (received := witness.receive(timeout=60.0)) and received.sequence < start + 200:
        pass
    if drop == "oldest":
        until(lambda: subscriber.drops == 190, "what the queue cannot hold is dropped")
        assert bifrost.wait([subscriber], timeout=5.0) == [subscriber]
    # What the witness has may still be on its way to this subscriber: all that comes until it is quiet.
    counts = [received.message.count for received in iter(lambda: subscriber.receive(timeout=1.0), None)]
    assert counts[: len(kept)] == kept  # the network's buffers hold more than a queue that drops the newest
    assert subscriber.drops == (190 if drop == "oldest" else 0)
    with selectors.DefaultSelector() as selector:
        selector.register(subscriber.fileno(), selectors.EVENT_READ)
        subscriber.drain()
        publisher.publish(sample(7))
        assert selector.select(timeout=5.0)
    last = subscriber.receive(timeout=60.0)
    assert last is not None and last.message.count == 7
    subscriber.close()


def test_a_stopped_subscriber_does_not_delay_the_publisher(net: BifrostNetwork) -> None:
    peer = net.peer("subscribe", "lab/sample", "100")
    publisher = net.node("publisher").publisher("lab/sample", Sample)
    witness = net.node("witness").subscriber("lab/sample", Sample, queue=100_000)
    first = connected(publisher, witness)
    assert peer.line()["count"] == 0
    large = sample(1, size=1000)

    def median_publication() -> float:
        """Of this thread's own time; one that waited for the subscriber would never end."""
        times = []
        for _ in range(1500):
            before = time.thread_time()
            publisher.publish(large)
            times.append(time.thread_time() - before)
            time.sleep(0.0002)
        return float(np.median(times))

    undisturbed = median_publication()
    peer.signal(signal.SIGSTOP)
    # More than its socket buffers and the publisher's high-water mark hold.
    disturbed = median_publication()
    last = publisher.publish(sample(2))
    peer.signal(signal.SIGCONT)
    assert disturbed < 5.0 * undisturbed + 20e-6
    assert sequences(witness, last) == list(range(first + 1, last + 1))
    assert witness.drops == 0


def test_closing_gives_everything_back(net: BifrostNetwork) -> None:
    def descriptors() -> int:
        return len(os.listdir("/proc/self/fd"))

    def open_and_close() -> None:
        with bifrost.Node("short", network=net.network) as node:
            publisher = node.publisher("lab/sample", Sample)
            subscriber = node.subscriber("lab/sample", Sample, queue=5)
            node.subscriber("lab/none", Sample).close()
            node.server("lab/ask", Sample, Sample, lambda request, origin: request)
            node.client("lab/none", Sample, Sample)
            connected(publisher, subscriber)
        node.close()

    open_and_close()
    threads, before = threading.active_count(), descriptors()
    for _ in range(15):
        open_and_close()
    assert threading.active_count() == threads
    assert descriptors() <= before
    with pytest.raises(bifrost.Error, match="closed"):
        node = net.node("late")
        node.close()
        node.publisher("lab/sample", Sample)


def test_wrong_use_is_told_at_once(net: BifrostNetwork) -> None:
    node = net.node("test")
    publisher = node.publisher("lab/sample", Sample)
    with pytest.raises(TypeError, match=r"lab/sample: expected Sample, got Other"):
        publisher.publish(Other(1.0))  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"Sample\.values: expected a one-dimensional float64 array, got list"):
        publisher.publish(Sample(1, "", [1.0], np.zeros(1, np.uint8)))  # type: ignore[arg-type]
    for name in ("", "/lab", "lab//x", "lab x", "lab\0x", "l" * 256):
        with pytest.raises(ValueError, match="topic name"):
            node.subscriber(name, Sample)
    with pytest.raises(ValueError, match="at least 1"):
        node.subscriber("lab/sample", Sample, queue=0)
    with pytest.raises(ValueError, match="drop: expected newest or oldest"):
        node.subscriber("lab/sample", Sample, queue=1, drop="all")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="drop: expected a queue"):
        node.subscriber("lab/sample", Sample, drop="oldest")
    assert publisher.publish(sample(1)) == 1  # nothing was sent above
    publisher.close()
    with pytest.raises(bifrost.Error, match="closed"):
        publisher.publish(sample(1))


class Rogue:
    """A member of the network that publishes bytes of its own making under the right topic and type."""

    def __init__(self, network: BifrostNetwork) -> None:
        self.node = network.node("rogue")
        self.socket = self.node.listening_socket(zmq.PUB)
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
        received = []
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
    counts = []
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


def test_any_type_is_decoded_by_its_registered_schema(net: BifrostNetwork) -> None:
    net.peer("publish", "lab/sample", "100")
    received = net.node("test").subscribe_any("lab/sample", queue=10).receive(timeout=60.0)
    assert received is not None
    message = received.message
    assert not isinstance(message, Sample)
    assert type(message).__name__ == "Sample"
    assert bifrost.to_builtins(message) == bifrost.to_builtins(sample(getattr(message, "count")))  # noqa: B009
