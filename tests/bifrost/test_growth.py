"""As a network grows: many topics between two nodes, many nodes at once, more sockets than there may be."""

from __future__ import annotations

import resource
import threading
from collections.abc import Iterator

import psutil
import pytest

import bifrost
from bifrost import security
from harness.bifrost_network import BifrostNetwork, Sample, connected, sample, until

_TOPICS = 1050  # more than ZeroMQ's own limit of sockets
_NODES = 100


@pytest.fixture
def descriptors() -> Iterator[None]:
    """As many as two ends of each topic in one process take."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard < 5 * _TOPICS:
        pytest.skip(f"{hard} file descriptors; {5 * _TOPICS} are wanted")
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, 5 * _TOPICS), hard))
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@pytest.mark.usefixtures("descriptors")
def test_a_thousand_topics_between_two_nodes(net: BifrostNetwork) -> None:
    names = [f"lab/topic_{i}" for i in range(_TOPICS)]
    near, far = net.node("near"), net.node("far")
    subscribers = [near.subscriber(name, Sample) for name in names]
    publishers = [far.publisher(name, Sample) for name in names]
    silent = dict(zip(subscribers, publishers, strict=True))

    def all_heard() -> bool:
        for publisher in silent.values():
            publisher.publish(sample(1))
        for subscriber in bifrost.wait(list(silent), timeout=0.05):
            if subscriber.latest() is not None:
                del silent[subscriber]
        return not silent

    until(all_heard, "each topic is heard on", 60.0)
    assert sum(subscriber.rejected for subscriber in subscribers) == 0
    # One topic more or less concerns nobody else.
    extra = near.subscriber("lab/extra", Sample)
    connected(far.publisher("lab/extra", Sample), extra)
    extra.close()
    assert [subscriber.publishers for subscriber in subscribers] == [("far",)] * _TOPICS


def test_a_hundred_nodes_that_come_at_once_know_each_other(net: BifrostNetwork) -> None:
    nodes: list[bifrost.Node] = []

    def join(first: int) -> None:
        for i in range(first, _NODES, 4):
            node = net.node(f"node_{i}")
            node.publisher("lab/all", Sample)
            nodes.append(node)

    threads = [threading.Thread(target=join, args=(first,)) for first in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    everybody = {f"node_{i}" for i in range(_NODES)}

    def told(node: bifrost.Node) -> set[str]:
        return {record.name for record in node.discovery.records() if record.entries}

    until(lambda: all(told(node) == everybody for node in nodes), "each knows all, and what they publish", 60.0)


def test_more_sockets_than_there_may_be(net: BifrostNetwork, monkeypatch: pytest.MonkeyPatch) -> None:
    publisher = net.node("far").publisher("lab/sample", Sample)
    node = net.node("test")
    subscriber = node.subscriber("lab/sample", Sample, queue=1000)
    connected(publisher, subscriber)
    more: list[bifrost.Subscriber[Sample]] = []
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (psutil.Process().num_fds() + 50, hard))
    try:
        with pytest.raises(bifrost.Error, match=r"another socket: Too many open files.*RLIMIT_NOFILE"):
            more += [node.subscriber(f"lab/{i}", Sample) for i in range(100)]
        publisher.publish(sample(7))
        received = subscriber.receive(timeout=60.0)
        assert received is not None
        assert received.message == sample(7)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    monkeypatch.setattr(security, "MAX_SOCKETS", 10)
    small = net.node("small")
    with pytest.raises(bifrost.Error, match="at most 10 a node"):
        more += [small.subscriber(f"lab/{i}", Sample) for i in range(20)]
    # What could not be made has left nothing behind.
    connected(publisher, node.subscriber("lab/sample", Sample))
