"""Publish and subscribe across real processes."""

import os
import signal
import socket as sockets
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

import bifrost
from harness.bifrost_network import BifrostNetwork, Peer, Sample, connected, sample, sequences, until
from harness.waiting import some

pytestmark = pytest.mark.portable


class Other(bifrost.Message):
    count: float


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
    assert latest.latest() is None and latest.receive(timeout=0.0) is None
    assert latest.receive(timeout=0.05) is None and latest.drain() == [] and (queue.drops, latest.drops) == (0, 0)


def test_drops_of_a_full_queue_are_counted(net: BifrostNetwork) -> None:
    publisher = net.node("publisher").publisher("lab/sample", Sample)
    subscriber = net.node("subscriber").subscriber("lab/sample", Sample, queue=10)
    first = connected(publisher, subscriber)
    large = sample(1, size=4000)
    for _ in range(6000):
        publisher.publish(large)
    received = last = 0

    def drained() -> bool:
        nonlocal received, last
        last = publisher.publish(sample(2))
        for r in subscriber.drain():
            received += 1
            if r.sequence == last:
                return True
        return False

    until(drained, "the message after the flood")
    assert subscriber.drops > 0 and received + subscriber.drops == last - first


def test_a_killed_publisher_is_replaced_without_a_gap(net: BifrostNetwork) -> None:
    peer = net.peer("publish", "lab/sample", "200")
    subscriber = net.node("test").subscriber("lab/sample", Sample, queue=1000)
    for _ in range(20):
        assert subscriber.receive(timeout=60.0) is not None
    assert len(subscriber.publishers) == 1
    peer.kill()
    killed = time.monotonic_ns()
    until(lambda: not subscriber.publishers, "the killed publisher is not listed", 5.0)
    subscriber.drain()
    net.peer("publish", "lab/sample", "200")

    def of_the_new_one() -> bool:
        again = some(subscriber.receive(timeout=60.0))
        return again.stamp > killed

    until(of_the_new_one, "a message of the one that came after")
    assert subscriber.drops == 0
    until(lambda: subscriber.drain() is not None and len(subscriber.publishers) == 1, "the dead one is let go")


def test_another_type_is_rejected_and_both_are_named(net: BifrostNetwork, caplog: pytest.LogCaptureFixture) -> None:
    node = net.node("publisher")
    wrong, right = node.publisher("lab/sample", Other), node.publisher("lab/other", Sample)
    other = net.node("subscriber")
    refusing, accepting = other.subscriber("lab/sample", Sample, queue=9), other.subscriber("lab/other", Sample)
    connected(right, accepting)
    wrong.publish(Other(1.0))
    assert refusing.receive(timeout=0.2) is None
    [record] = until(lambda: refusing.drain() == [] and caplog.records, "the warning")
    for word in ("lab/sample: publisher publishes Other", "subscriber expects Sample"):
        assert word in record.getMessage()


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
    assert sorted(counts) == [*range(300), *range(1000, 1300)] and [c for c in counts if c < 1000] == list(range(300))
    assert subscriber.drops == 0


@pytest.mark.parametrize("queue", [None, 100])
def test_a_late_subscriber_gets_the_last_latched_message_once(net: BifrostNetwork, queue: int | None) -> None:
    publisher = net.node("publisher").publisher("lab/sample", Sample, latched=True)
    for count in range(5):
        publisher.publish(sample(count))
    late = net.node("late").subscriber("lab/sample", Sample, queue=queue)
    received = late.receive(timeout=60.0)
    assert received is not None and (received.sequence, received.message) == (5, sample(4))
    publisher.publish(sample(5))
    later = net.node("later").subscriber("lab/sample", Sample, queue=queue)
    anybody = net.node("anybody").subscribe_any("lab/sample", queue=queue)
    everybody: tuple[bifrost.Subscriber[Any], ...] = (late, later, anybody)
    for subscriber in everybody:
        received = subscriber.receive(timeout=60.0)
        assert received is not None and received.sequence == 6
    assert publisher.publish(sample(6)) == 7
    for subscriber in everybody:
        received = subscriber.receive(timeout=60.0)
        assert received is not None and received.sequence == 7
        assert subscriber.receive(timeout=0.1) is None and (subscriber.drops, subscriber.rejected) == (0, 0)
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
    first = some(subscriber.receive(timeout=60.0))
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
    assert sequences(witness, last) == list(range(first + 1, last + 1)) and witness.drops == 0


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


def test_wrong_use_raises_at_once(net: BifrostNetwork) -> None:
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
    assert publisher.publish(sample(1)) == 1  # nothing was sent above
    publisher.close()
    with pytest.raises(bifrost.Error, match="closed"):
        publisher.publish(sample(1))
