"""Request and reply across real processes."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
import zmq

import bifrost
from bifrost import wire
from bifrost.directory import Entry
from bifrost.waiting import Waitable
from harness.bifrost_network import Answer, BifrostNetwork, Question, Sample, going_on

pytestmark = pytest.mark.portable


class Number(bifrost.Message):
    """A type that the server does not know."""

    value: int


@contextmanager
def served(server: bifrost.Server[Question, Answer]) -> Iterator[None]:
    with going_on(lambda: bifrost.wait([server], timeout=0.05) and server.serve()):
        yield


def client_of(net: BifrostNetwork, name: str = "asker") -> bifrost.Client[Question, Answer]:
    return net.node(name).client("lab/ask", Question, Answer)


def handled(client: bifrost.Client[Question, Answer]) -> int:
    return client.call(Question("count", 0.0), timeout=60.0).handled


def test_no_server_and_no_daemon(bare_network: BifrostNetwork) -> None:
    with pytest.raises(bifrost.NoServerError, match=r"bifrostd at tcp://127\.0\.0\.1:[0-9]+ does not respond"):
        client_of(bare_network).call(Question("open", 0.0), timeout=0.1)


def test_a_server_that_starts_during_the_call_answers_it(net: BifrostNetwork) -> None:
    client = client_of(net)
    replies: list[Answer] = []
    thread = threading.Thread(target=lambda: replies.append(client.call(Question("open", 0.0), timeout=20.0)))
    thread.start()
    net.peer("serve", "lab/ask")
    thread.join()
    assert replies == [Answer("open for asker", 1)]


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


def test_a_handler_that_returns_something_else(net: BifrostNetwork) -> None:
    server = net.node("server").server("lab/ask", Question, Answer, lambda q, origin: Number(1))  # type: ignore[arg-type,return-value]
    with served(server), pytest.raises(bifrost.RemoteError, match="the handler returned Number, not Answer"):
        client_of(net).call(Question("open", 0.0), timeout=60.0)


def test_a_loop_sends_a_request_without_waiting(net: BifrostNetwork) -> None:
    """One thread: it asks, receives a topic all the while, and has the reply when it is there."""
    net.peer("serve", "lab/ask")
    net.peer("publish", "lab/sample", "200")
    node = net.node("looper")
    client = node.client("lab/ask", Question, Answer)
    subscriber = node.subscriber("lab/sample", Sample)
    assert subscriber.receive(timeout=20.0)
    client.ask(Question("sleep", 0.3), timeout=20.0)
    assert client.answer() is None
    both: list[Waitable] = [subscriber, client]
    received, answer = 0, None
    while answer is None:
        ready = bifrost.wait(both, timeout=20.0)
        assert ready
        received += subscriber.latest() is not None
        answer = client.answer()
    assert answer == Answer("sleep for looper", 1)
    assert received > 5
    assert client.answer() is None  # it is reported once
    assert client.call(Question("open", 0.0), timeout=60.0).handled == 2  # waiting and looping mix
    for count in range(3, 30):
        client.ask(Question("open", 0.0), timeout=10.0)
        assert bifrost.wait([client], timeout=20.0) == [client]
        assert client.answer() == Answer("open for looper", count)


def test_answer_raises_the_errors_of_call(net: BifrostNetwork) -> None:
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
