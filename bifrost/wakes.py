"""Wakes a node's waiting subscribers: publishes the bare topic to their sockets within the process."""

import threading

import zmq

_ENDPOINT = "inproc://bifrost.wake"


class Wakes:
    """Topics whose subscribers must check for changes. ``add`` may be called from any thread."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]]) -> None:
        self.socket = context.socket(zmq.XPUB)  # readable after a new subscription
        self.socket.setsockopt(zmq.LINGER, 0)
        self.socket.setsockopt(zmq.XPUB_VERBOSE, 1)
        self.socket.bind(_ENDPOINT)
        self._lock = threading.Lock()
        self._topics: set[str] = set()

    @staticmethod
    def connect(socket: zmq.Socket[bytes]) -> None:
        """Connect a subscriber's socket, which subscribes to its topic."""
        socket.connect(_ENDPOINT)

    def add(self, topic: str) -> None:
        """Wake a topic's subscribers at the next ``send``."""
        with self._lock:
            self._topics.add(topic)

    def receive(self) -> None:
        """Wake new subscribers, which may have missed an earlier wake."""
        while True:
            try:
                frame = self.socket.recv(zmq.NOBLOCK)
            except zmq.Again:
                return
            if frame[:1] == b"\x01":
                self.add(frame[1:-1].decode())

    def send(self) -> None:
        """Wake the subscribers of the added topics."""
        with self._lock:
            topics, self._topics = self._topics, set()
        for topic in topics:
            self.socket.send(topic.encode() + b"\0", zmq.NOBLOCK)
