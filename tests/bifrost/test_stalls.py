"""Full queues end no process: libzmq's timeouts must not meet a full queue."""

import zmq

from harness.bifrost_network import Answer, BifrostNetwork, Question, Sample
from harness.waiting import PATIENCE

STALL = 3.0  # longer than the heartbeats that libzmq would need to notice [s]
REQUESTS = 3000  # more than a server's socket holds


def test_a_full_queue_lives_through_the_end_of_its_publisher(net: BifrostNetwork) -> None:
    """Twenty rounds, ten at a time: stall, kill, reconnect."""
    stalling = net.peer("stall", "lab/sample", str(STALL))
    witness = net.node("witness").subscriber("lab/sample", Sample, queue=10_000)
    for _ in range(2):
        publisher = net.peer("publish", "lab/sample", "1000")
        assert stalling.line() == "all have heard"
        witness.drain()
        assert None not in [witness.receive(PATIENCE) for _ in range(200)]  # ten fill a queue
        publisher.kill()
    net.peer("publish", "lab/sample", "1000")
    assert stalling.line() == "all have heard"


def test_a_full_server_lives_through_the_end_of_its_client(net: BifrostNetwork) -> None:
    serving = net.peer("serve", "lab/ask")
    node = net.node("test")
    client = node.client("lab/ask", Question, Answer)
    assert client.call(Question("count", 0.0), PATIENCE).handled == 0
    [server] = node.graph(PATIENCE).services["lab/ask"].servers
    with node.discovery.connecting_socket(zmq.DEALER) as socket:
        socket.setsockopt(zmq.SNDHWM, REQUESTS)
        socket.connect(server.endpoint)
        client.ask(Question("sleep", STALL), PATIENCE)
        assert serving.line() == "asleep"
        for _ in range(REQUESTS):
            socket.send(b"lab/ask\0" + bytes(1000), zmq.NOBLOCK)
    assert client.call(Question("open", 0.0), PATIENCE).handled == 2
    assert serving.alive()
