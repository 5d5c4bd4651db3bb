"""One end, or both ends, of the thesis' latency test.

``python -m thesis.experiments.ipc_peer bifrost both 10 1200`` is both ends.

A publisher thread sends increasing numbers and stores the time of each; a subscriber thread stores the time of each
reception. At the end all are printed: ``sent NUMBER TIME`` or ``received NUMBER TIME``, monotonic clock [ns], which all
processes of a computer share.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable

import bifrost

TOPIC = "experiment/number"
DEADLINE = 20.0  # timeout of the discovery, and after the last message [s]


class Number(bifrost.Message):
    """The thesis' message: a single double."""

    value: float


class BifrostTransport:
    """One end of a connection that transfers doubles, over Bifrost."""

    def __init__(self, publishes: bool, listens: bool) -> None:
        self._node = bifrost.Node(f"ipc_peer_{int(publishes)}{int(listens)}")
        self._publisher = self._node.publisher(TOPIC, Number) if publishes else None
        self._subscriber = self._node.subscriber(TOPIC, Number, queue=100) if listens else None

    def publish(self, value: float) -> None:
        """Send a number."""
        assert self._publisher is not None
        self._publisher.publish(Number(value))

    def found(self) -> bool:
        """Return whether a subscriber is discovered."""
        assert self._publisher is not None
        return self._publisher.subscribers > 0

    def wait_for_subscriber(self) -> None:
        """Return at once: a subscriber is discovered by its subscription, which the publisher has received."""

    def listen(self, hear: Callable[[float], None], done: threading.Event) -> None:
        """Call ``hear`` with every number received until ``done``."""
        assert self._subscriber is not None
        while not done.is_set():
            if received := self._subscriber.receive(timeout=0.2):
                hear(received.message.value)

    def close(self) -> None:
        self._node.close()


class RosTransport:
    """The same over rclpy on Fast DDS, as the robot's processes use it."""

    def __init__(self, publishes: bool, listens: bool) -> None:
        import rclpy
        from rclpy.signals import SignalHandlerOptions
        from std_msgs.msg import Float64

        self._type = Float64
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node(f"ipc_peer_{int(publishes)}{int(listens)}", enable_rosout=False)
        self._publisher = self._node.create_publisher(Float64, TOPIC, 100) if publishes else None

    def publish(self, value: float) -> None:
        assert self._publisher is not None
        self._publisher.publish(self._type(data=value))

    def found(self) -> bool:
        assert self._publisher is not None
        return bool(self._publisher.get_subscription_count())

    def wait_for_subscriber(self) -> None:
        """Wait for acknowledgements: each end discovers the other independently."""
        from rclpy.duration import Duration

        assert self._publisher is not None
        self._publisher.wait_for_all_acked(Duration(seconds=DEADLINE))

    def listen(self, hear: Callable[[float], None], done: threading.Event) -> None:
        from rclpy.executors import SingleThreadedExecutor

        self._node.create_subscription(self._type, TOPIC, lambda message: hear(message.data), 100)
        executor = SingleThreadedExecutor()
        executor.add_node(self._node)
        while not done.is_set():
            executor.spin_once(timeout_sec=0.2)
        executor.shutdown()

    def close(self) -> None:
        import rclpy

        self._node.destroy_node()
        rclpy.shutdown()


TRANSPORTS: dict[str, type[BifrostTransport] | type[RosTransport]] = {"bifrost": BifrostTransport, "ros": RosTransport}
ROLES = ("both", "publish", "receive")


def main(name: str, role: str, rate: float, count: int) -> int:
    """Take part in one test of ``count`` messages at ``rate`` [Hz]; returns the exit status."""
    publishes, listens = role != "receive", role != "publish"
    transport = TRANSPORTS[name](publishes, listens)
    received: list[tuple[float, int]] = []
    sent: list[tuple[float, int]] = []
    done = threading.Event()

    def hear(value: float) -> None:
        received.append((value, time.monotonic_ns()))
        if value >= count - 1:
            done.set()

    def send() -> None:
        deadline = time.monotonic() + DEADLINE
        while not transport.found() and time.monotonic() < deadline:
            time.sleep(0.01)
        due = time.monotonic()
        for i in range(-3, count):  # the first three are not counted: caches, connections
            due += 1.0 / rate
            time.sleep(max(0.0, due - time.monotonic()))
            if i == 0:
                transport.wait_for_subscriber()
                due = time.monotonic()
            if i >= 0:
                sent.append((float(i), time.monotonic_ns()))
            transport.publish(float(i))
        transport.wait_for_subscriber()  # closing earlier would lose messages in transit

    listener = threading.Thread(target=transport.listen, args=(hear, done)) if listens else None
    if listener:
        listener.start()
    if publishes:
        send()
    if listener:
        done.wait(DEADLINE + (0.0 if publishes else count / rate + DEADLINE))
        done.set()
        listener.join()
    transport.close()
    for word, notes in (("sent", sent), ("received", received)):
        for value, at in notes:
            if value >= 0:
                print(word, int(value), at)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2], float(sys.argv[3]), int(sys.argv[4])))
