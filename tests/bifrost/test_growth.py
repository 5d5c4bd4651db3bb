"""Large networks: many topics between two nodes, many nodes at once, too many sockets."""

import resource
import threading
from collections.abc import Iterator

import pytest

import bifrost
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

    def all_received() -> bool:
        for publisher in silent.values():
            publisher.publish(sample(1))
        for subscriber in bifrost.wait(list(silent), timeout=0.05):
            if subscriber.latest() is not None:
                del silent[subscriber]
        return not silent

    until(all_received, "each topic is heard on", 60.0)
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

    def reported(node: bifrost.Node) -> set[str]:
        return {record.name for record in node.discovery.records() if record.entries}

    until(lambda: all(reported(node) == everybody for node in nodes), "each knows all, and what they publish", 60.0)
