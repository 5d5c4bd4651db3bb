"""Request and reply across real processes."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
import zmq

import bifrost
from bifrost import wire
from bifrost.directory import Entry
from bifrost.waiting import Waitable
from harness.bifrost_network import (
    Answer,
    BifrostNetwork,
    Peer,
    Question,
    Sample,
    going_on,
    until,
)


class Number(bifrost.Message):
    """A type that the server does not know."""

    value: int


@contextmanager
def served(server: bifrost.Server[Question, Answer]) -> Iterator[None]:
    """Serve in a thread of its own."""
    with going_on(lambda: bifrost.wait([server], timeout=0.05) and server.serve()):
        yield


def client_of(net: BifrostNetwork, name: str = "asker") -> bifrost.Client[Question, Answer]:
    return net.node(name).client("lab/ask", Question, Answer)


def handled(client: bifrost.Client[Question, Answer]) -> int:
    """How many questions the server has handled."""
    return client.call(Question("count", 0.0), timeout=60.0).handled


def test_a_server_answers_another_process_and_learns_who_asks(net: BifrostNetwork) -> None:
    net.peer("serve", "lab/ask")
    client = client_of(net)
    for count in range(1, 50):
        reply = client.call(Question("open", 1.5), timeout=60.0)
        assert reply == Answer("open for asker", count)
    assert client.server == "serve_peer"


def test_what_the_handler_raises_reaches_the_client_and_ends_nothing(net: BifrostNetwork) -> None:
    peer = net.peer("serve", "lab/ask")
    client = client_of(net)
    with pytest.raises(bifrost.RemoteError, match=r"^lab/ask: ValueError: no such valve$"):
        client.call(Question("raise", 0.0), timeout=60.0)
    assert client.call(Question("open", 0.0)).handled == 2
    assert peer.alive()


def test_no_server(net: BifrostNetwork) -> None:
    client = client_of(net)
    before = time.monotonic()
    with pytest.raises(bifrost.NoServerError, match=r"^lab/ask: no server within 0.3 s$"):
        client.call(Question("open", 0.0), timeout=0.3)
    assert time.monotonic() - before >= 0.3


def test_no_server_and_no_daemon(bare_network: BifrostNetwork) -> None:
    with pytest.raises(bifrost.NoServerError, match=r"bifrostd at tcp://127\.0\.0\.1:[0-9]+ does not answer"):
        client_of(bare_network).call(Question("open", 0.0), timeout=0.1)


def test_a_server_that_starts_during_the_call_answers_it(net: BifrostNetwork) -> None:
    client = client_of(net)
    replies: list[Answer] = []
    thread = threading.Thread(target=lambda: replies.append(client.call(Question("open", 0.0), timeout=20.0)))
    thread.start()
    net.peer("serve", "lab/ask")
    thread.join()
    assert replies == [Answer("open for asker", 1)]


def test_a_late_reply_is_never_taken_for_another(net: BifrostNetwork) -> None:
    net.peer("serve", "lab/ask")
    client = client_of(net)
    client.call(Question("open", 0.0), timeout=60.0)
    for _ in range(3):
        with pytest.raises(bifrost.TimeoutError, match=r"^lab/ask: no reply from serve_peer within 0.05 s$"):
            client.call(Question("sleep", 0.15), timeout=0.05)
        assert client.call(Question("close", 0.0), timeout=60.0).text == "close for asker"


def test_a_reply_to_another_request_is_passed_over(net: BifrostNetwork) -> None:
    """A server that answers with old request ids before the right one."""
    node = net.node("odd")
    socket = node.discovery.listening_socket(zmq.ROUTER)
    socket.bind("tcp://127.0.0.1:*")
    question, answer = bifrost.codec(Question), bifrost.codec(Answer)
    hashes = (question.hash.hex(), answer.hash.hex())
    endpoint = socket.getsockopt_string(zmq.LAST_ENDPOINT)
    entry = Entry("server", "lab/ask", ("Question", "Answer"), hashes, endpoint)
    node.discovery.announce(entry, [question.schema, answer.schema])

    def serve_oddly() -> None:
        sender, frame = socket.recv_multipart()
        request_id = wire.REQUEST.unpack_from(frame, len(b"lab/ask\0"))[3]
        for old in (request_id - 1, request_id + 1, 0):
            reply = wire.REPLY.pack(wire.VERSION, old, wire.OK) + answer.encode(Answer("wrong", 0))
            socket.send_multipart([sender, reply])
        socket.send_multipart([sender, b"\x01"])
        socket.send_multipart(
            [sender, wire.REPLY.pack(wire.VERSION, request_id, wire.OK) + answer.encode(Answer("right", 1))]
        )

    thread = threading.Thread(target=serve_oddly)
    thread.start()
    assert client_of(net).call(Question("open", 0.0), timeout=60.0) == Answer("right", 1)
    thread.join()
    socket.close()


def test_a_killed_server_is_replaced(net: BifrostNetwork) -> None:
    peer = net.peer("serve", "lab/ask")
    client = client_of(net)
    client.call(Question("open", 0.0), timeout=60.0)
    errors: list[Exception] = []

    def call() -> None:
        try:
            client.call(Question("sleep", 30.0), timeout=1.0)
        except bifrost.Error as error:
            errors.append(error)

    thread = threading.Thread(target=call)
    thread.start()
    assert peer.line() == "asleep"
    peer.kill()
    thread.join()
    assert isinstance(errors[0], bifrost.TimeoutError) and isinstance(errors[0], TimeoutError)
    net.peer("serve", "lab/ask")
    assert client.call(Question("open", 0.0), timeout=60.0) == Answer("open for asker", 1)


def test_a_request_that_nobody_waits_for_is_not_carried_out(net: BifrostNetwork) -> None:
    peer = net.peer("serve", "lab/ask")
    client = client_of(net)
    client.call(Question("open", 0.0), timeout=60.0)
    peer.signal(signal.SIGSTOP)
    for _ in range(3):
        with pytest.raises(bifrost.TimeoutError):
            client.call(Question("open", 0.0), timeout=0.1)
    peer.signal(signal.SIGCONT)
    assert handled(client) == 1


def test_other_types_are_refused_and_both_are_named(net: BifrostNetwork) -> None:
    net.peer("serve", "lab/ask")
    client = net.node("asker").client("lab/ask", Question, Number)
    with pytest.raises(bifrost.SchemaError) as caught:
        client.call(Question("open", 0.0), timeout=60.0)
    for word in ("lab/ask", "serve_peer", "asker", "Question -> Answer", "Question -> Number"):
        assert word in str(caught.value)
    assert handled(client_of(net, "other")) == 0


@pytest.fixture
def rogue_call(net: BifrostNetwork) -> Iterator[Callable[[Peer, bytes], list[bytes]]]:
    """Send a frame of one's own making, as a member, to a server; gives what comes back."""
    node = net.node("rogue")
    sockets = []

    def call(peer: Peer, frame: bytes) -> list[bytes]:
        def endpoint() -> str | None:
            service = node.graph().services.get("lab/ask")
            return service.servers[-1].endpoint if service and service.servers else None

        socket = node.discovery.connecting_socket(zmq.DEALER)
        sockets.append(socket)
        socket.connect(until(endpoint, "the server is known") or "")
        socket.send(frame)
        replies = []
        while socket.poll(300):
            replies.append(socket.recv())
        return replies

    yield call
    for socket in sockets:
        socket.close()


def test_a_server_survives_what_a_member_sends(
    net: BifrostNetwork, rogue_call: Callable[[Peer, bytes], list[bytes]]
) -> None:
    peer = net.peer("serve", "lab/ask")
    question, answer = bifrost.codec(Question), bifrost.codec(Answer)

    def request(topic: bytes, reply_hash: bytes, payload: bytes) -> bytes:
        deadline = time.monotonic_ns() + 10**10
        header = wire.REQUEST.pack(
            wire.VERSION, question.hash, reply_hash, 42, wire.computer_id(), deadline, len(b"rogue")
        )
        return topic + b"\0" + header + b"rogue" + payload

    def status(frame: bytes) -> tuple[int, int, str]:
        _, request_id, code = wire.REPLY.unpack_from(frame)
        return request_id, code, frame[wire.REPLY.size :].decode()

    good = question.encode(Question("open", 0.0))
    assert rogue_call(peer, b"") == []
    assert rogue_call(peer, b"\xff" * 500) == []
    [garbage] = rogue_call(peer, request(b"lab/ask", answer.hash, b"\xc1"))
    assert status(garbage)[:2] == (42, wire.REFUSED)
    [short] = rogue_call(peer, request(b"lab/ask", answer.hash, good[:-1]))
    assert status(short)[:2] == (42, wire.REFUSED)
    [other_topic] = rogue_call(peer, request(b"lab/other", answer.hash, good))
    assert status(other_topic) == (42, wire.OTHER_TOPIC, "lab/ask")
    [other_type] = rogue_call(peer, request(b"lab/ask", bytes(8), good))
    assert status(other_type)[:2] == (42, wire.OTHER_SCHEMA)
    assert "serve_peer" in status(other_type)[2] and "rogue" in status(other_type)[2]
    assert peer.alive()
    client = client_of(net)
    assert handled(client) == 0
    assert client.call(Question("open", 0.0), timeout=60.0).handled == 1


def test_a_handler_that_returns_something_else(net: BifrostNetwork) -> None:
    server = net.node("server").server("lab/ask", Question, Answer, lambda q, origin: Number(1))  # type: ignore[arg-type,return-value]
    with served(server), pytest.raises(bifrost.RemoteError, match="the handler returned Number, not Answer"):
        client_of(net).call(Question("open", 0.0), timeout=60.0)


def test_many_clients_at_once(net: BifrostNetwork) -> None:
    net.peer("serve", "lab/ask")
    clients = [client_of(net, f"asker{i}") for i in range(4)]
    wrong: list[Answer] = []

    def ask(index: int) -> None:
        for count in range(50):
            reply = clients[index].call(Question(f"{index}.{count}", 0.0), timeout=60.0)
            if reply.text != f"{index}.{count} for asker{index}":
                wrong.append(reply)

    threads = [threading.Thread(target=ask, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong
    assert handled(clients[0]) == 200


def test_a_loop_asks_and_goes_on(net: BifrostNetwork) -> None:
    """One thread: it asks, hears a topic all the while, and has the reply when it is there."""
    net.peer("serve", "lab/ask")
    net.peer("publish", "lab/sample", "200")
    node = net.node("looper")
    client = node.client("lab/ask", Question, Answer)
    subscriber = node.subscriber("lab/sample", Sample)
    assert subscriber.receive(timeout=20.0)
    client.ask(Question("sleep", 0.3), timeout=20.0)
    assert client.answer() is None
    both: list[Waitable] = [subscriber, client]
    heard, answer = 0, None
    while answer is None:
        ready = bifrost.wait(both, timeout=20.0)
        assert ready
        heard += subscriber.latest() is not None
        answer = client.answer()
    assert answer == Answer("sleep for looper", 1)
    assert heard > 5
    assert client.answer() is None  # it is told once
    assert client.call(Question("open", 0.0), timeout=60.0).handled == 2  # waiting and looping mix
    for count in range(3, 30):
        client.ask(Question("open", 0.0), timeout=10.0)
        assert bifrost.wait([client], timeout=20.0) == [client]
        assert client.answer() == Answer("open for looper", count)


def test_a_loop_is_told_what_a_call_would_have_raised(net: BifrostNetwork) -> None:
    node = net.node("looper")
    client = node.client("lab/ask", Question, Answer)

    def answer_to(question: Question, timeout: float = 20.0) -> Answer | None:
        client.ask(question, timeout)
        assert bifrost.wait([client], timeout=30.0) == [client]
        return client.answer()

    with pytest.raises(bifrost.NoServerError, match=r"^lab/ask: no server within 0.1 s$"):
        answer_to(Question("open", 0.0), 0.1)
    with pytest.raises(TypeError, match="expected Question, got Number"):
        client.ask(Number(1))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="nothing to wait for"):
        bifrost.wait([client])
    assert bifrost.wait([client], timeout=0.01) == []
    peer = net.peer("serve", "lab/ask")  # comes while the question is open
    assert answer_to(Question("open", 0.0)) == Answer("open for looper", 1)
    with pytest.raises(bifrost.RemoteError, match="no such valve"):
        answer_to(Question("raise", 0.0))
    with pytest.raises(bifrost.TimeoutError, match=r"no reply from serve_peer within 0\.05 s"):
        answer_to(Question("sleep", 0.3), 0.05)
    client.ask(Question("sleep", 0.2), timeout=10.0)  # given up: its late reply is not taken for the next one's
    assert answer_to(Question("close", 0.0)) == Answer("close for looper", handled(client))
    wrong = node.client("lab/ask", Question, Number)
    wrong.ask(Question("open", 0.0), timeout=10.0)
    assert bifrost.wait([wrong], timeout=20.0) == [wrong]
    with pytest.raises(bifrost.SchemaError, match="Question -> Number"):
        wrong.answer()
    client.ask(Question("sleep", 30.0), timeout=1.0)
    assert bifrost.wait([client], timeout=0.05) == []
    peer.kill()  # in mid-request
    assert bifrost.wait([client], timeout=20.0) == [client]
    with pytest.raises(bifrost.TimeoutError):
        client.answer()
    net.peer("serve", "lab/ask")
    assert answer_to(Question("open", 0.0)) == Answer("open for looper", 1)


def test_serve_never_waits(net: BifrostNetwork) -> None:
    server = net.node("server").server("lab/ask", Question, Answer, lambda q, origin: Answer("", 0))
    assert server.serve() == 0
    assert bifrost.wait([server], timeout=0.0) == []
    assert not server.ready()
