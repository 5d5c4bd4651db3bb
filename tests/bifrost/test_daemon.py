"""The name service: nodes find each other, and go on without it."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest
import zmq

import bifrost
from bifrost import directory
from bifrost.keepsake import recall
from harness.bifrost_network import (
    Answer,
    BifrostNetwork,
    Question,
    Sample,
    until,
)


def names(node: bifrost.Node) -> set[str]:
    return set(node.graph(timeout=10.0).nodes)


def test_data_flows_while_the_daemon_is_dead_and_all_register_again(own_net: BifrostNetwork) -> None:
    own_net.peer("publish", "lab/sample", "100")
    own_net.peer("serve", "lab/ask")
    node = own_net.node("test")
    subscriber = node.subscriber("lab/sample", Sample, queue=10_000)
    client = node.client("lab/ask", Question, Answer)
    assert subscriber.receive(timeout=60.0)
    assert client.call(Question("open", 0.0), timeout=60.0).handled == 1
    own_net.kill_daemon()
    received = [subscriber.receive(timeout=60.0) for _ in range(100)]
    assert None not in received
    assert client.call(Question("open", 0.0), timeout=60.0).handled == 2
    late = own_net.node("late")
    late_subscriber = late.subscriber("lab/sample", Sample)
    assert late_subscriber.receive(timeout=0.2) is None
    own_net.start_daemon()
    assert late_subscriber.receive(timeout=60.0) is not None
    until(lambda: names(node) == {"publish_peer", "serve_peer", "test", "late"}, "all have registered again")
    while subscriber.drain():
        pass
    assert subscriber.receive(timeout=60.0) is not None
    assert subscriber.drops == 0


def left_on_disk(net: BifrostNetwork) -> set[str]:
    return {record.name for record in recall(net.network)}


def test_who_must_find_somebody_without_a_daemon_finds_whom_the_last_one_knew(own_net: BifrostNetwork) -> None:
    own_net.peer("serve", "lab/ask")
    speaker = own_net.peer("publish", "lab/sample", "100")
    node = own_net.node("test")
    until(lambda: left_on_disk(own_net) == {"serve_peer", "publish_peer", "test"}, "all are on disk")
    assert own_net.network.keepsake is not None
    assert own_net.network.keepsake.stat().st_mode & 0o777 == 0o600
    node.close()
    until(lambda: "test" not in left_on_disk(own_net), "who has left is not")
    own_net.kill_daemon()

    late = own_net.node_in(own_net.network, "late", recall=True)
    subscriber = late.subscriber("lab/sample", Sample)
    assert late.client("lab/ask", Question, Answer).call(Question("open", 0.0), timeout=60.0).handled == 1
    assert subscriber.receive(timeout=60.0) is not None
    speaker.kill()
    subscriber.latest()  # its last
    assert left_on_disk(own_net) == {"serve_peer"}, "a process that has ended is nobody"

    own_net.peer("publish", "lab/sample", "100")
    own_net.start_daemon()
    assert late.discovery.wait_change(lambda: late.discovery.registered, 20.0)
    until(subscriber.latest, "who came meanwhile is found, too")
    daemon = own_net.daemons.popitem()[1]
    daemon.terminate()
    daemon.wait(20.0)
    assert not own_net.network.keepsake.exists(), "one that ends in order leaves nothing"


@pytest.mark.parametrize("content", [b"", b"\xc1", b"\x91" * 100_000, b'{"type": "table"}'], ids=repr)
def test_a_file_that_says_nothing_is_as_good_as_none(tmp_path: Path, content: bytes) -> None:
    network = bifrost.Network.create(tmp_path / "network.json", tmp_path / "keys")
    assert recall(network) == []
    assert network.keepsake is not None
    network.keepsake.write_bytes(content)
    assert recall(network) == []


def test_a_subscriber_is_not_cut_off_by_a_daemon_that_knows_nobody_yet(own_net: BifrostNetwork) -> None:
    peer = own_net.peer("publish", "lab/sample", "100")
    subscriber = own_net.node("test").subscriber("lab/sample", Sample, queue=10_000)
    assert subscriber.receive(timeout=60.0)
    own_net.kill_daemon()
    peer.signal(signal.SIGSTOP)  # it cannot register again
    own_net.start_daemon()
    watching = own_net.node("watching")
    until(lambda: {"test", "watching"} <= names(watching), "the others have registered again")
    subscriber.drain()
    peer.signal(signal.SIGCONT)
    assert subscriber.receive(timeout=60.0) is not None
    assert subscriber.drops == 0


def test_killed_left_and_silent_nodes_are_dropped(net: BifrostNetwork) -> None:
    watching = net.node("watching")
    killed = net.peer("publish", "lab/killed", "10")
    silent = net.peer("serve", "lab/silent")
    left = net.node("left")
    left.publisher("lab/left", Sample)
    until(lambda: names(watching) == {"watching", "publish_peer", "serve_peer", "left"}, "all are there")
    left.close()
    until(lambda: names(watching) == {"watching", "publish_peer", "serve_peer"}, "one has left")
    killed.kill()
    until(lambda: names(watching) == {"watching", "serve_peer"}, "the killed one is dropped")
    silent.signal(signal.SIGSTOP)  # its connections stay open: only its silence tells
    until(lambda: names(watching) == {"watching"}, "the silent one is dropped", 20.0)
    silent.signal(signal.SIGCONT)
    until(lambda: names(watching) == {"watching", "serve_peer"}, "the silent one is back")


def test_the_graph_names_everything(net: BifrostNetwork) -> None:
    peer = net.peer("publish", "lab/sample", "10")
    net.peer("serve", "lab/ask")
    node = net.node("test")
    node.subscriber("lab/sample", Sample)
    node.subscribe_any("lab/sample")
    node.client("lab/ask", Question, Answer)
    graph = until(lambda: (g := node.graph(10.0)) and len(g.nodes) == 3 and g, "three nodes")
    topic, service = graph.topics["lab/sample"], graph.services["lab/ask"]
    [publisher] = topic.publishers
    assert (publisher.node, publisher.pid, publisher.computer) == ("publish_peer", peer.pid, "localhost")
    assert publisher.endpoint.startswith("tcp://127.0.0.1:")
    assert topic.types == ["Sample"]
    assert [end.types for end in topic.subscribers] == [("Sample",), ()]
    assert [end.node for end in service.servers] == ["serve_peer"]
    assert [end.types for end in service.clients] == [("Question", "Answer")]
    assert graph.schemas[publisher.hashes[0]] == bifrost.codec(Sample).schema


def test_the_daemon_tells_how_it_fares(own_net: BifrostNetwork) -> None:
    info = bifrost.daemon_alive(own_net.network, timeout=5.0)
    assert info is not None
    assert info.pid == own_net.daemon.pid
    assert info.uptime > 0.0
    assert 1.0 < info.memory_mib < 200.0
    own_net.kill_daemon()
    assert bifrost.daemon_alive(own_net.network, timeout=0.2) is None
    with pytest.raises(bifrost.TimeoutError, match="does not answer"):
        own_net.node("test").graph(timeout=0.1)


def test_the_daemon_survives_what_a_member_sends(net: BifrostNetwork) -> None:
    node = net.node("rogue")
    record = directory.NodeRecord("ghost", 1, 2, "localhost", 3)
    socket = node.discovery.connecting_socket(zmq.DEALER)
    socket.connect(net.network.computer.daemon)
    for content in (b"", b"\xc1", b"\x00" * 1000, b"\x91" * 5000, directory.encode({"type": "register", "node": 1})):
        socket.send(content)
    socket.send_multipart([b"a", b"b", b"c"])
    socket.send(directory.encode(directory.Leave(12345)))
    socket.send(directory.encode(directory.Register(record)))
    until(lambda: "ghost" in names(node), "the sane one among them is heard")
    socket.close()
    until(lambda: "ghost" not in names(node), "its end is noticed")


def run_daemon(environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "bifrost.daemon"],
        env=environment,
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )


def test_a_daemon_that_cannot_start_says_why_in_one_line(net: BifrostNetwork, tmp_path: Path) -> None:
    taken = run_daemon(net.environment())
    assert taken.returncode == 75  # another start may succeed
    assert taken.stderr.count("\n") == 1
    assert f"cannot listen on {net.network.computer.daemon}: Address already in use" in taken.stderr
    missing = run_daemon(net.environment() | {"BIFROST_NETWORK": str(tmp_path / "none.json")})
    assert missing.returncode == 78
    assert "none.json: no such network file" in missing.stderr
    assert missing.stderr.count("\n") == 1
