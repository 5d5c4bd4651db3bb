"""Waiting for topics: wake-ups, pollers, descriptors, across real processes."""

import selectors
import threading
import time
from typing import Any

import numpy as np
import pytest

import bifrost
from harness.bifrost_network import BifrostNetwork, Sample, connected, sample, until


def test_no_wake_up_is_ever_lost(net: BifrostNetwork) -> None:
    """Ping-pong: each side answers only when woken; a lost wake-up would end it."""
    ping_node, pong_node = net.node("ping"), net.node("pong")
    ping, pong = ping_node.publisher("lab/ping", Sample), pong_node.publisher("lab/pong", Sample)
    received_ping = pong_node.subscriber("lab/ping", Sample)
    received_pong = ping_node.subscriber("lab/pong", Sample)
    connected(ping, received_ping)
    connected(pong, received_pong)
    rounds = 2000
    failures: list[int] = []

    def answer() -> None:
        for count in range(rounds):
            if not (bifrost.wait([received_ping], timeout=5.0) and received_ping.latest()):
                failures.append(count)
                return
            pong.publish(sample(count, 1))

    thread = threading.Thread(target=answer)
    thread.start()
    for count in range(rounds):
        ping.publish(sample(count, 1))
        received = received_pong.receive(timeout=60.0)
        assert received is not None and received.message.count == count, f"round {count}, {failures}"
    thread.join()
    assert not failures


def test_wait_returns_the_items_with_messages(net: BifrostNetwork) -> None:
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


@pytest.mark.parametrize("queue", [None, 10])
def test_a_wait_is_ended_from_another_thread_without_a_loss(net: BifrostNetwork, queue: int | None) -> None:
    publisher = net.node("publisher").publisher("lab/sample", Sample)
    subscriber = net.node("subscriber").subscriber("lab/sample", Sample, queue)
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
    # Woken while a message waits: either comes first, and neither keeps the next message from being received.
    publisher.publish(sample(7))
    assert bifrost.wait([subscriber], timeout=5.0) == [subscriber]
    subscriber.wake()
    until(
        lambda: (arrived := subscriber.receive(timeout=60.0)) is not None and arrived.message.count == 7, "the message"
    )
    publisher.publish(sample(8))
    until(
        lambda: (arrived := subscriber.receive(timeout=60.0)) is not None and arrived.message.count == 8, "the message"
    )
    assert (subscriber.drops, subscriber.rejected) == (0, 0)


def test_a_poller_reports_each_item_once(net: BifrostNetwork) -> None:
    publishing, subscribing = net.node("publishing"), net.node("subscribing")
    publishers = [publishing.publisher(f"lab/{name}", Sample) for name in ("a", "b")]
    subscribers = [subscribing.subscriber(f"lab/{name}", Sample, queue=100) for name in ("a", "b")]
    server = subscribing.server("lab/serve", Sample, Sample, lambda request, origin: request)
    for publisher, subscriber in zip(publishers, subscribers, strict=True):
        connected(publisher, subscriber)
    poller = bifrost.Poller[Any]([*subscribers, server])
    try:
        assert poller.look() == [*subscribers, server]  # of what came before, nobody reports again
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
        taken: list[Any] = []

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


def test_a_loop_that_drains_what_its_poller_reports_misses_no_message(net: BifrostNetwork) -> None:
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
