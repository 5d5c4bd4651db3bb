"""Processes without keys, or with other keys, receive nothing."""

import psutil
import zmq

import bifrost
from harness.bifrost_network import BifrostNetwork, Sample, ports, until


def test_only_holders_of_the_keys_receive_messages(net: BifrostNetwork) -> None:
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
        received = {name for name, socket in listening.items() if name != "member" and socket.poll(0)}
        assert not received
    finally:
        context.destroy(linger=0)


def test_keys_of_another_network_are_rejected(net: BifrostNetwork) -> None:
    """Same network file, other keys: not even the daemon answers."""
    other = net.file.parent / "other_keys"
    bifrost.Network.create(net.file.parent / "other.json", other)
    stranger = bifrost.Network.load(net.file, other)
    net.peer("publish", "lab/sample", "200")
    assert bifrost.daemon_alive(stranger, timeout=0.5) is None
    with bifrost.Node("stranger", network=stranger) as node:
        assert node.subscriber("lab/sample", Sample).receive(timeout=0.5) is None and not node.discovery.connected
    member = net.node("member")
    until(lambda: set(member.graph().nodes) == {"member", "publish_peer"}, "the stranger is not in the table")


def test_everything_listens_on_the_networks_interface_alone(net: BifrostNetwork) -> None:
    peers = [net.peer("publish", "lab/sample", "10"), net.peer("serve", "lab/ask")]
    for pid in (net.daemon.pid, *(peer.pid for peer in peers)):
        for connection in psutil.Process(pid).net_connections("inet"):
            assert connection.laddr.ip == "127.0.0.1"
