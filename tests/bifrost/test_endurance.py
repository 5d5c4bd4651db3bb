"""What does not end a network: nodes that come and go all the time, clocks that step, members that talk nonsense."""

from __future__ import annotations

import secrets
import subprocess
import sys
import threading
import time

import msgspec
import zmq

import bifrost
from bifrost import directory, wire
from bifrost.directory import Entry, NodeRecord
from harness.bifrost_network import (
    Answer,
    BifrostNetwork,
    Question,
    Sample,
    connected,
    sample,
    sequences,
    until,
)
from harness.places import REPOSITORY
from harness.waiting import PATIENCE

JOINS_PER_SECOND = 24


def test_nodes_that_come_and_go_lose_nobody_a_message(net: BifrostNetwork) -> None:
    """Half take their leave, half go without a word; a queue that is not full loses nothing meanwhile."""
    publisher = net.node("publisher").publisher("lab/sample", Sample)
    subscriber = net.node("listener").subscriber("lab/sample", Sample, queue=100_000)
    client = net.node("asker").client("lab/ask", Question, Answer)
    net.peer("serve", "lab/ask")
    first = connected(publisher, subscriber)
    stop = threading.Event()

    def publish() -> None:
        count = 0
        while not stop.wait(0.005):
            count += 1
            publisher.publish(sample(count))

    def come_and_go(number: int) -> None:
        if number % 2:
            with bifrost.Node(f"guest_{number}", network=net.network) as guest:
                guest.publisher(f"lab/guest_{number}", Sample)
                guest.subscriber("lab/sample", Sample)
            return
        socket = watching.discovery.connecting_socket(zmq.DEALER)
        socket.connect(net.network.computer.daemon)
        entry = Entry("publisher", "lab/sample", ("Sample",), (bifrost.codec(Sample).hash.hex(),), "tcp://127.0.0.1:9")
        record = NodeRecord(f"ghost_{number}", secrets.randbits(63), 1, "localhost", time.monotonic_ns(), (entry,))
        socket.send(directory.encode(directory.Register(record)))
        assert socket.poll(10_000)  # it is in the table
        socket.close()

    watching = net.node("watching")
    thread = threading.Thread(target=publish)
    thread.start()
    try:
        due = time.monotonic()
        for number in range(4 * JOINS_PER_SECOND):
            come_and_go(number)
            due += 1.0 / JOINS_PER_SECOND
            time.sleep(max(0.0, due - time.monotonic()))
    finally:
        stop.set()
        thread.join()
    last = publisher.publish(sample(0))
    assert sequences(subscriber, last) == list(range(first + 1, last + 1))
    assert (subscriber.drops, subscriber.rejected) == (0, 0)
    assert client.call(Question("open", 0.0), timeout=60.0).handled == 1
    staying = {"publisher", "listener", "asker", "serve_peer", "watching"}
    until(lambda: set(watching.graph(10.0).nodes) == staying, "whoever has gone is out of the table", 20.0)


# A process whose wall clock jumps by hours, to and fro, all the time.
STEPPING = """
import runpy, sys, time
true_time, true_ns, calls = time.time, time.time_ns, 0
def step():
    global calls
    calls += 1
    return (-7200, 3600, 0)[calls % 3]
time.time = lambda: true_time() + step()
time.time_ns = lambda: true_ns() + step() * 10**9
sys.argv = sys.argv[1:]
runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
"""


def test_steps_of_the_wall_clock_change_nothing(bare_network: BifrostNetwork) -> None:
    net = bare_network

    def start(*arguments: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-c", STEPPING, *arguments]
        return subprocess.Popen(command, cwd=REPOSITORY, env=net.environment(), stdout=subprocess.DEVNULL)

    net.log.touch()
    net.daemons[net.network.computer.name] = start("bifrost.daemon")
    module = "harness.bifrost_peer"
    peers = [start(module, "publish", "lab/sample", "200"), start(module, "serve", "lab/ask")]
    try:
        node = net.node("test")
        subscriber = node.subscriber("lab/sample", Sample, queue=100_000)
        client = node.client("lab/ask", Question, Answer)
        first = subscriber.receive(timeout=120.0)
        assert first is not None
        for count in range(1, 21):
            assert client.call(Question("open", 0.0), timeout=20.0).handled == count
        last = first.sequence
        while last < first.sequence + 1000:  # more than the time in which the silent are dropped
            received = subscriber.receive(timeout=60.0)
            assert received is not None and received.sequence == last + 1
            last = received.sequence
        assert (subscriber.drops, subscriber.rejected) == (0, 0)
        assert set(node.graph(10.0).nodes) == {"publish_peer", "serve_peer", "test"}
    finally:
        for peer in peers:
            peer.kill()
            peer.wait()


def test_a_server_refuses_nonsense_and_counts_it(net: BifrostNetwork) -> None:
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
    statuses = [wire.REPLY.unpack_from(reply)[2] for reply in replies]
    assert statuses[-1] == wire.OK and wire.OK not in statuses[:-1]


def test_the_daemon_refuses_nonsense_and_counts_it(own_net: BifrostNetwork) -> None:
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
