"""The socket of a latched publisher, while subscribers start and end."""

from collections.abc import Callable
from typing import Any

import zmq

from bifrost import wire
from bifrost.publisher import Latch
from harness.bifrost_network import BifrostNetwork, until

NAME = b"lab/sample\0"
PATIENCE = 10_000  # [ms]


class Interrupted(zmq.Socket[bytes]):
    """A socket whose process is held up before it sends."""

    meanwhile: Callable[[], None] | None = None

    def send(self, *arguments: Any, **options: Any) -> Any:
        """Send, once what comes in between is done."""
        if happens := self.meanwhile:
            self.meanwhile = None
            happens()
        return super().send(*arguments, **options)


def frame(count: int) -> bytearray:
    return bytearray(NAME + bytes([wire.VERSION, count]))


def test_a_new_subscriber_receives_messages_while_others_end(net: BifrostNetwork) -> None:
    """libzmq forgets whom it is admitting when the end of another subscription reaches the socket."""
    with zmq.Context() as context:
        socket = context.socket(zmq.XPUB, socket_class=Interrupted)
        latch = Latch(socket, "127.0.0.1", NAME[:-1].decode(), net.node("publisher").discovery)

        def joined() -> zmq.Socket[bytes]:
            subscriber = context.socket(zmq.SUB)
            subscriber.linger = 0
            subscriber.connect(latch.endpoint)
            subscriber.setsockopt(zmq.SUBSCRIBE, NAME)
            assert subscriber.poll(PATIENCE) and subscriber.recv() == NAME + wire.LATCHED + bytes([wire.VERSION, 1])
            return subscriber

        latch.send(frame(1))
        first = joined()

        def first_leaves() -> None:
            first.close()
            until(
                lambda: int(socket.getsockopt(zmq.EVENTS)) & zmq.POLLIN, "the end of its subscription at the publisher"
            )

        socket.meanwhile = first_leaves
        second = joined()
        latch.send(frame(2))
        received = second.poll(PATIENCE)
        latch.close()
        until(lambda: socket.closed, "the publisher's end")
        assert received
        assert second.recv() == frame(2)
        second.close()
