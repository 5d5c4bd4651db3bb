"""Several computers: their daemons exchange tables, and nodes find each other by topic, also after failures."""

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import bifrost
from bifrost import Computer
from harness.bifrost_network import Answer, BifrostNetwork, Question, Sample, until
from harness.computers import Computers, ComputersError, computers


def names(node: bifrost.Node) -> set[str]:
    return set(node.graph(timeout=10.0).nodes)


@pytest.mark.parametrize("order", ["near far nodes", "near nodes far", "nodes far near"])
def test_nodes_find_each_other_in_any_order_of_start(two_computers: BifrostNetwork, order: str) -> None:
    net = two_computers
    subscriber = client = None
    for what in order.split():
        if what == "nodes":
            net.peer("publish", "lab/sample", "100", computer="far")
            net.peer("serve", "lab/ask", computer="far")
            node = net.node("test", "near")
            subscriber = node.subscriber("lab/sample", Sample, queue=10_000)
            client = node.client("lab/ask", Question, Answer)
        else:
            net.start_daemon(what)
    assert subscriber is not None and client is not None
    received = [subscriber.receive(timeout=60.0) for _ in range(50)]
    assert None not in received
    assert (subscriber.drops, subscriber.rejected) == (0, 0)
    assert client.call(Question("open", 0.0), timeout=60.0).text == "open for test"
    graph = node.graph(10.0)
    [publisher] = graph.topics["lab/sample"].publishers
    assert publisher.computer == "far" and publisher.endpoint.startswith("tcp://127.0.0.2:")
    watching = net.node("watching", "far")
    until(lambda: names(watching) == {"publish_peer", "serve_peer", "test", "watching"}, "far lists all nodes of near")


def test_a_node_that_ends_is_removed_on_its_computer_and_on_the_other(two_computers: BifrostNetwork) -> None:
    net = two_computers
    net.start_daemon("near")
    net.start_daemon("far")
    watching = [net.node("watching", "near"), net.node("neighbor", "far")]
    killed = net.peer("publish", "lab/killed", "10", computer="far")
    silent = net.peer("serve", "lab/silent", computer="far")
    left = net.node("left", "far")
    left.publisher("lab/left", Sample)

    def listed(*others: str, within: float = 10.0) -> None:
        expected = {"watching", "neighbor", *others}
        until(lambda: all(names(node) == expected for node in watching), f"both list {expected}", within)

    listed("publish_peer", "serve_peer", "left")
    left.close()
    listed("publish_peer", "serve_peer")
    killed.kill()
    listed("serve_peer")
    silent.signal(signal.SIGSTOP)  # its connections stay open: only its silence shows
    listed(within=20.0)
    silent.signal(signal.SIGCONT)
    listed("serve_peer")


@pytest.mark.parametrize("killed", ["near", "far"])
def test_data_flows_without_a_daemon_and_nodes_meet_again(two_computers: BifrostNetwork, killed: str) -> None:
    net = two_computers
    net.start_daemon("near")
    net.start_daemon("far")
    net.peer("publish", "lab/sample", "100", computer="far")
    net.peer("serve", "lab/ask", computer="far")
    node = net.node("test", "near")
    subscriber = node.subscriber("lab/sample", Sample, queue=10_000)
    client = node.client("lab/ask", Question, Answer)
    assert subscriber.receive(timeout=60.0)
    assert client.call(Question("open", 0.0), timeout=60.0).handled == 1
    net.kill_daemon(killed)
    if killed == "far":  # out of the table, still connected
        until(lambda: names(node) == {"test"}, "far's nodes are out of the table", 20.0)
    subscriber.drain()
    assert None not in [subscriber.receive(timeout=60.0) for _ in range(100)]
    assert client.call(Question("open", 0.0), timeout=60.0).handled == 2
    net.start_daemon(killed)
    newcomer = net.node("newcomer", "near").subscriber("lab/sample", Sample)
    assert newcomer.receive(timeout=60.0) is not None
    until(lambda: names(node) == {"publish_peer", "serve_peer", "test", "newcomer"}, "all are registered again")
    while subscriber.drain():
        pass
    assert subscriber.receive(timeout=60.0) is not None and subscriber.drops == 0


def test_a_stopped_daemon_is_unreachable_until_it_continues(two_computers: BifrostNetwork) -> None:
    net = two_computers
    net.start_daemon("near")
    far = net.start_daemon("far")
    net.peer("publish", "lab/sample", "10", computer="far")
    node = net.node("test", "near")
    until(lambda: names(node) == {"test", "publish_peer"}, "all are listed")
    info = bifrost.daemon_alive(net.on("near"), 5.0)
    assert info is not None and info.computers == ["far"] and info.nodes == 1
    far.send_signal(signal.SIGSTOP)
    until(lambda: names(node) == {"test"}, "the other computer is out of reach", 20.0)
    info = bifrost.daemon_alive(net.on("near"), 5.0)
    assert info is not None and info.computers == []
    far.send_signal(signal.SIGCONT)
    until(lambda: names(node) == {"test", "publish_peer"}, "it is back", 20.0)


# --- two computers with a cable between them --------------------------------------------------------------------------
@pytest.fixture
def cabled(tmp_path: Path) -> Iterator[tuple[BifrostNetwork, Computers]]:
    try:
        with computers("near", "far", network=os.getpid() % 250) as cables:
            made = BifrostNetwork(
                tmp_path, (), [Computer(name, address, 23456) for name, address in cables.addresses.items()]
            )
            made.within = {name: cables.inside(name) for name in cables.addresses}
            yield made, cables
            made.close()
    except ComputersError as error:
        pytest.skip(str(error))


def test_a_cable_pulled_and_plugged_in_again(cabled: tuple[BifrostNetwork, Computers]) -> None:
    net, cables = cabled
    net.start_daemon("near")
    net.start_daemon("far")
    publisher = net.peer("publish", "lab/sample", "20", computer="far")
    subscriber = net.peer("subscribe", "lab/sample", "1000", computer="near")
    first = subscriber.line()
    assert first["drops"] == 0
    before = net.log.read_text().count("is unreachable")  # a busy computer may delay a beat
    cables.pull("far")
    until(lambda: net.log.read_text().count("is unreachable") >= before + 2, "each daemon lost the other", 30.0)
    cables.plug("far")
    plugged = time.monotonic()
    last, lost = first["sequence"], 0
    while last < first["sequence"] + 200:
        line = subscriber.line()
        lost += line["sequence"] - last - 1
        assert line["drops"] == lost  # each one that was lost is counted
        last = line["sequence"]
        assert time.monotonic() < plugged + 30.0
    assert publisher.alive() and subscriber.alive()
    # A new node finds the others too.
    late = net.peer("subscribe", "lab/sample", "10", computer="near")
    assert late.line()["count"] > 0


@pytest.fixture(params=[3.0, -3.0])
def clocks_apart(two_computers: BifrostNetwork, request: pytest.FixtureRequest) -> BifrostNetwork:
    """Far, with a clock ahead of near's or behind it."""
    within = ("unshare", "--time", f"--monotonic={request.param:g}", f"--boottime={request.param:g}")
    if subprocess.run([*within, "true"], capture_output=True, check=False).returncode:
        pytest.skip("no time namespaces here")
    two_computers.within["far"] = within
    for computer in ("near", "far"):
        two_computers.start_daemon(computer)
    return two_computers


def test_stamps_of_another_computer_are_converted_to_the_local_clock(clocks_apart: BifrostNetwork) -> None:
    node = clocks_apart.node("test", "near")
    subscriber = node.subscriber("lab/sample", Sample, queue=10_000)
    clocks_apart.peer("publish", "lab/sample", "100", computer="far")
    received = [subscriber.receive(timeout=60.0) for _ in range(100)]
    ages = [1e-9 * (each.arrived - each.stamp) for each in received if each]
    assert len(ages) == 100 and subscriber.rejected == 0
    # From the first on: neither 3 s late nor in the future by more than the clock's error.
    assert min(ages) > -0.5 and sorted(ages)[50] < 1.0, ages
    [info] = [bifrost.daemon_alive(clocks_apart.on("near"), 5.0)]
    assert info is not None
    ahead, error = info.clocks["far"]
    assert abs(abs(ahead) - 3.0) <= error + 0.01


def test_a_late_request_from_another_computer_is_rejected(clocks_apart: BifrostNetwork) -> None:
    """A request that arrives after its client's timeout, by the server's clock, which is 3 s from the client's."""
    clocks_apart.peer("serve", "lab/ask", computer="far")
    client = clocks_apart.node("test", "near").client("lab/ask", Question, Answer)
    question = Question("open", 0.0)
    assert client.call(question, timeout=60.0).text == "open for test"
    socket, server = client._socket, client._watch.peers[-1]
    assert socket is not None

    for ends in (-0.2, 60.0, -0.2):
        socket.send(client._frame(client._request.encode(question), time.monotonic() + ends, server))
    assert client.call(Question("count", 0.0), timeout=60.0).handled == 2
