"""Several computers: their daemons follow each other, nodes find each other by topic alone, and re-form."""

from __future__ import annotations

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


def names(node: bifrost.Node) -> set[str]:
    return set(node.graph(timeout=10.0).nodes)


@pytest.mark.parametrize("order", ["near far nodes", "near nodes far", "nodes far near"])
def test_nodes_find_each_other_whoever_comes_first(two_computers: BifrostNetwork, order: str) -> None:
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
    assert publisher.computer == "far"
    assert publisher.endpoint.startswith("tcp://127.0.0.2:")
    watching = net.node("watching", "far")
    until(lambda: names(watching) == {"publish_peer", "serve_peer", "test", "watching"}, "far knows all of near")


def test_a_node_that_goes_is_gone_on_the_other_computer(two_computers: BifrostNetwork) -> None:
    net = two_computers
    net.start_daemon("near")
    net.start_daemon("far")
    watching = net.node("watching", "near")
    killed = net.peer("publish", "lab/killed", "10", computer="far")
    silent = net.peer("serve", "lab/silent", computer="far")
    left = net.node("left", "far")
    until(lambda: names(watching) == {"watching", "publish_peer", "serve_peer", "left"}, "all are there")
    left.close()
    until(lambda: names(watching) == {"watching", "publish_peer", "serve_peer"}, "one has left")
    killed.kill()
    until(lambda: names(watching) == {"watching", "serve_peer"}, "the killed one is dropped")
    silent.signal(signal.SIGSTOP)
    until(lambda: names(watching) == {"watching"}, "the silent one is dropped", 20.0)
    silent.signal(signal.SIGCONT)
    until(lambda: names(watching) == {"watching", "serve_peer"}, "the silent one is back")


@pytest.mark.parametrize("killed", ["near", "far"])
def test_data_flows_while_a_daemon_is_dead_and_all_find_each_other_again(
    two_computers: BifrostNetwork, killed: str
) -> None:
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
    assert subscriber.receive(timeout=60.0) is not None
    assert subscriber.drops == 0


def test_a_stopped_daemon_is_out_of_reach_and_back(two_computers: BifrostNetwork) -> None:
    net = two_computers
    net.start_daemon("near")
    far = net.start_daemon("far")
    net.peer("publish", "lab/sample", "10", computer="far")
    node = net.node("test", "near")
    until(lambda: names(node) == {"test", "publish_peer"}, "all are there")
    info = bifrost.daemon_alive(net.on("near"), 5.0)
    assert info is not None and info.computers == ["far"] and info.nodes == 1
    far.send_signal(signal.SIGSTOP)
    until(lambda: names(node) == {"test"}, "the other computer is out of reach", 20.0)
    info = bifrost.daemon_alive(net.on("near"), 5.0)
    assert info is not None and info.computers == []
    far.send_signal(signal.SIGCONT)
    until(lambda: names(node) == {"test", "publish_peer"}, "it is back", 20.0)


# --- two computers with a cable between them --------------------------------------------------------------------------


def ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True, text=True)


@pytest.fixture
def cabled(tmp_path: Path) -> Iterator[BifrostNetwork]:
    """Two network namespaces joined by a pair of virtual interfaces; the far one is named ``far``."""
    tag = f"bf{os.getpid()}"
    spaces = {"near": f"{tag}n", "far": f"{tag}f"}
    try:
        for space in spaces.values():
            ip("netns", "add", space)
        ip("link", "add", f"{tag}n", "netns", spaces["near"], "type", "veth", "peer", f"{tag}f", "netns", spaces["far"])
        for number, space in enumerate(spaces.values(), 1):
            ip("-n", space, "address", "add", f"10.213.7.{number}/24", "dev", space)
            ip("-n", space, "link", "set", "lo", "up")
            ip("-n", space, "link", "set", space, "up")
    except (OSError, subprocess.CalledProcessError) as error:
        for space in spaces.values():
            subprocess.run(["ip", "netns", "del", space], check=False, capture_output=True)
        pytest.skip(f"network namespaces cannot be made here: {getattr(error, 'stderr', error)}")
    made = BifrostNetwork(tmp_path, (), [Computer("near", "10.213.7.1", 23456), Computer("far", "10.213.7.2", 23456)])
    made.within = {name: ("ip", "netns", "exec", space) for name, space in spaces.items()}
    yield made
    made.close()
    for space in spaces.values():
        ip("netns", "del", space)


def test_a_cable_pulled_and_put_back(cabled: BifrostNetwork) -> None:
    net = cabled
    net.start_daemon("near")
    net.start_daemon("far")
    publisher = net.peer("publish", "lab/sample", "20", computer="far")
    subscriber = net.peer("subscribe", "lab/sample", "1000", computer="near")
    first = subscriber.line()
    assert first["drops"] == 0
    [far_end] = [space[3] for name, space in net.within.items() if name == "far"]
    ip("-n", far_end, "link", "set", far_end, "down")
    until(lambda: net.log.read_text().count("cannot be reached") == 2, "each daemon has given the other up", 30.0)
    ip("-n", far_end, "link", "set", far_end, "up")
    put_back = time.monotonic()
    last, lost = first["sequence"], 0
    while last < first["sequence"] + 200:
        line = subscriber.line()
        lost += line["sequence"] - last - 1
        assert line["drops"] == lost  # each one that was lost is counted
        last = line["sequence"]
        assert time.monotonic() < put_back + 30.0
    assert publisher.alive() and subscriber.alive()
    # Newcomers on either side find the others too.
    late = net.peer("subscribe", "lab/sample", "10", computer="near")
    assert late.line()["count"] > 0


@pytest.fixture(params=[3.0, -3.0])
def clocks_apart(two_computers: BifrostNetwork, request: pytest.FixtureRequest) -> BifrostNetwork:
    """The clock of far is ahead of near's, or behind it."""
    within = ("unshare", "--time", f"--monotonic={request.param:g}", f"--boottime={request.param:g}")
    if subprocess.run([*within, "true"], capture_output=True, check=False).returncode:
        pytest.skip("no time namespaces here")
    two_computers.within["far"] = within
    for computer in ("near", "far"):
        two_computers.start_daemon(computer)
    return two_computers


def test_stamps_of_another_computer_are_brought_to_ones_own_clock(clocks_apart: BifrostNetwork) -> None:
    node = clocks_apart.node("test", "near")
    subscriber = node.subscriber("lab/sample", Sample, queue=10_000)
    clocks_apart.peer("publish", "lab/sample", "100", computer="far")
    heard = [subscriber.receive(timeout=60.0) for _ in range(100)]
    ages = [1e-9 * (received.arrived - received.stamp) for received in heard if received]
    assert len(ages) == 100 and subscriber.rejected == 0
    # From the first on: 3 s would not pass, nor a stamp of the future by more than the clock is known to.
    assert min(ages) > -0.5 and sorted(ages)[50] < 1.0, ages
    [info] = [bifrost.daemon_alive(clocks_apart.on("near"), 5.0)]
    assert info is not None
    ahead, error, _ = info.clocks["far"]
    assert abs(abs(ahead) - 3.0) <= error + 0.01


def test_what_comes_late_from_another_computer_is_not_done(clocks_apart: BifrostNetwork) -> None:
    """A request that a cable has held back is one whose client has given up: by the server's clock, 3 s from ours."""
    clocks_apart.peer("serve", "lab/ask", computer="far")
    client = clocks_apart.node("test", "near").client("lab/ask", Question, Answer)
    question = Question("open", 0.0)
    assert client.call(question, timeout=60.0).text == "open for test"
    socket, server = client._socket, client._watch.peers[-1]
    assert socket is not None

    def passed() -> list[tuple[int, int]]:
        found = bifrost.counts(clocks_apart.on("near"), "lab/ask", 2.0)
        return [(each.messages, each.rejected) for counts in found.values() for each in counts if each.kind == "server"]

    for ends in (-0.2, 60.0, -0.2):
        socket.send(client._frame(client._request.encode(question), time.monotonic() + ends, server))
    until(lambda: passed() == [(2, 2)], "what holds is answered, what has ceased to hold is refused")
