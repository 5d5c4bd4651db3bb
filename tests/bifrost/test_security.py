"""Garbage and strangers at every port."""

from __future__ import annotations

import socket as sockets
import ssl

import psutil
import pytest
import zmq

import bifrost
from harness.bifrost_network import (
    Answer,
    BifrostNetwork,
    Question,
    Sample,
    ports,
    until,
)

GREETING = b"\xff" + bytes(8) + b"\x7f" + b"\x03\x01"  # signature and version of ZMTP 3.1
NULL_GREETING = GREETING + b"NULL".ljust(20, b"\0") + bytes(32)
CURVE_GREETING = GREETING + b"CURVE".ljust(20, b"\0") + bytes(32)


def tls_hello() -> bytes:
    """What a TLS client says first."""
    incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
    connection = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).wrap_bio(incoming, outgoing, server_hostname="x")
    with pytest.raises(ssl.SSLWantReadError):
        connection.do_handshake()
    return outgoing.read()


GARBAGE = {
    "nothing": b"",
    "http": b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n",
    "tls": tls_hello(),
    "zeros": bytes(4096),
    "ones": b"\xff" * 4096,
    "half a greeting": GREETING[:7],
    "greeting without mechanism": GREETING,
    "null mechanism": NULL_GREETING,
    "null mechanism and ready": NULL_GREETING + b"\x04\x19\x05READY\x0bSocket-Type\x00\x00\x00\x03SUB",
    "null mechanism and a huge frame": NULL_GREETING + b"\x02" + b"\xff" * 8,
    "zmtp 1": b"\x01\x00" + b"\x05\x00abcd" * 100,
    "zmtp 2": b"\xff" + bytes(8) + b"\x7f\x01\x02\x00\x00" + b"\x00\x05abcde" * 50,
    "curve greeting and noise": CURVE_GREETING + bytes(range(256)) * 8,
    "curve hello cut short": CURVE_GREETING + b"\x04\x06\x05HELLO",
    "curve hello of zeros": CURVE_GREETING + b"\x04\xc8\x05HELLO" + b"\x01\x00" + bytes(192),
    "curve initiate first": CURVE_GREETING + b"\x04\xff\x08INITIATE" + bytes(246),
    "curve long command": CURVE_GREETING + b"\x06" + b"\x7f" + b"\xff" * 7,
}


def throw(port: int, content: bytes) -> bytes:
    """Send bytes; gives what comes back at once."""
    with sockets.create_connection(("127.0.0.1", port), timeout=5.0) as connection:
        answer = b""
        try:
            connection.sendall(content)
            connection.settimeout(0.05)
            while part := connection.recv(4096):
                answer += part
        except OSError:  # it hung up, or has nothing more to say
            pass
        return answer


def test_garbage_on_every_port_ends_nothing_and_delays_nobody(net: BifrostNetwork) -> None:
    publisher, server = net.peer("publish", "lab/sample", "200"), net.peer("serve", "lab/ask")
    node = net.node("test")
    subscriber = node.subscriber("lab/sample", Sample, queue=10_000)
    client = node.client("lab/ask", Question, Answer)
    first = subscriber.receive(timeout=60.0)
    assert first is not None
    assert client.call(Question("open", 0.0), timeout=60.0)
    listening = [port for pid in (net.daemon.pid, publisher.pid, server.pid) for port in ports(pid)]
    assert len(listening) == 3  # a daemon, a publishing node and a server listen on one each
    for port in listening:
        for name, content in GARBAGE.items():
            answer = throw(port, content)
            # Whatever was said, only CURVE is offered, and no message comes.
            assert len(answer) < 600, name
            if len(answer) >= 32 and answer[10:11] == b"\x03":
                assert answer[12:32].rstrip(b"\0") == b"CURVE", name
    assert net.daemon.poll() is None
    assert publisher.alive() and server.alive()
    assert client.call(Question("open", 0.0), timeout=60.0).handled == 2
    messages = subscriber.drain()
    assert [m.sequence for m in messages] == list(range(first.sequence + 1, first.sequence + 1 + len(messages)))
    with bifrost.Node("newcomer", network=net.network) as newcomer:
        assert newcomer.subscriber("lab/sample", Sample).receive(timeout=60.0) is not None


def test_only_holders_of_the_keys_hear_anything(net: BifrostNetwork) -> None:
    publisher = net.peer("publish", "lab/sample", "200")
    [port] = ports(publisher.pid)
    member, server = net.network.client, net.network.server
    stranger = bifrost.network.KeyPair(*zmq.curve_keypair())
    attempts = {
        "member": (member, server.public),
        "another client key": (stranger, server.public),
        "another server key": (member, stranger.public),
        "the server's key pair as client": (server, server.public),
        "no security": None,
    }
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    listening = {}
    for name, keys in attempts.items():
        socket = listening[name] = context.socket(zmq.SUB)
        socket.setsockopt(zmq.LINGER, 0)
        if keys is not None:
            pair, server_key = keys
            socket.setsockopt(zmq.CURVE_SERVERKEY, server_key)
            socket.setsockopt(zmq.CURVE_PUBLICKEY, pair.public)
            socket.setsockopt(zmq.CURVE_SECRETKEY, pair.secret)
        socket.setsockopt(zmq.SUBSCRIBE, b"")
        socket.connect(f"tcp://127.0.0.1:{port}")
    try:
        # Two hundred messages for a member: time enough for the others, had they been let in.
        for _ in range(200):
            assert listening["member"].poll(5000)
            listening["member"].recv()
        heard = {name for name, socket in listening.items() if name != "member" and socket.poll(0)}
        assert not heard
    finally:
        context.destroy(linger=0)


def test_another_instances_keys_open_nothing(net: BifrostNetwork) -> None:
    """Same network file, other keys: not even the daemon answers."""
    other = net.file.parent / "other_keys"
    bifrost.Network.create(net.file.parent / "other.json", other)
    stranger = bifrost.Network.load(net.file, other)
    net.peer("publish", "lab/sample", "200")
    assert bifrost.daemon_alive(stranger, timeout=0.5) is None
    with bifrost.Node("stranger", network=stranger) as node:
        assert node.subscriber("lab/sample", Sample).receive(timeout=0.5) is None
        assert not node.discovery.connected
    member = net.node("member")
    until(lambda: set(member.graph().nodes) == {"member", "publish_peer"}, "the stranger is not in the table")


def test_everything_listens_on_the_networks_interface_alone(net: BifrostNetwork) -> None:
    peers = [net.peer("publish", "lab/sample", "10"), net.peer("serve", "lab/ask")]
    for pid in (net.daemon.pid, *(peer.pid for peer in peers)):
        for connection in psutil.Process(pid).net_connections("inet"):
            assert connection.laddr.ip == "127.0.0.1"
