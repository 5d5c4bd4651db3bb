"""Waking a node's subscribers, wherever they wait: the bare topic is published to their sockets within the process."""

from __future__ import annotations

import threading
import time

import zmq

_ENDPOINT = "inproc://bifrost.wake"


class Wakes:
    """Topics whose subscribers must look at what has changed. ``add`` and ``add_at`` may be called from any thread.

    Attributes:
        socket: readable when somebody has subscribed.
    """

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]]) -> None:
        self.socket = context.socket(zmq.XPUB)
        self.socket.setsockopt(zmq.LINGER, 0)
        self.socket.setsockopt(zmq.XPUB_VERBOSE, 1)
        self.socket.bind(_ENDPOINT)
        self._lock = threading.Lock()
        self._topics: set[str] = set()
        self._later: list[tuple[float, str]] = []  # when, monotonic [s]

    @staticmethod
    def connect(socket: zmq.Socket[bytes]) -> None:
        """Let a subscriber's socket, which subscribes to its topic, be woken."""
        socket.connect(_ENDPOINT)

    def add(self, topic: str) -> None:
        """Wake a topic's subscribers with the next ``send``."""
        with self._lock:
            self._topics.add(topic)

    def add_at(self, topic: str, when: float) -> None:
        """Wake them with the first ``send`` after a time [s, monotonic]."""
        with self._lock:
            self._later.append((when, topic))

    def receive(self) -> None:
        """Whoever has subscribed is woken, lest it has missed an earlier wake."""
        while True:
            try:
                frame = self.socket.recv(zmq.NOBLOCK)
            except zmq.Again:
                return
            if frame[:1] == b"\x01":
                self.add(frame[1:-1].decode())

    def send(self) -> None:
        """Wake those that are to be woken now."""
        with self._lock:
            if self._later:
                now = time.monotonic()
                self._topics |= {topic for when, topic in self._later if when <= now}
                self._later = [(when, topic) for when, topic in self._later if when > now]
            if not self._topics:
                return
            topics, self._topics = self._topics, set()
        for topic in topics:
            self.socket.send(topic.encode() + b"\0", zmq.NOBLOCK)
