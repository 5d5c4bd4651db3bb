"""A client of Foxglove's WebSocket protocol (foxglove.sdk.v1), and what its messages say."""

from __future__ import annotations

import base64
import json
import struct
import time
from collections import defaultdict
from collections.abc import Callable
from functools import partial
from typing import Any, Self

from websockets.sync.client import connect
from websockets.typing import Subprotocol

PROTOCOL = "foxglove.sdk.v1"
_MESSAGE_DATA, _ASSET = 1, 4
_ASSET_HEAD = struct.Struct("<IBI")  # of an asset: request, 0 for success, length of the error's text
_HEAD = struct.Struct("<IQ")  # of a message: subscription, log time [ns]


class Viewer:
    """Connects, and knows what it is told.

    Attributes:
        info: what the server says of itself.
        channels: that it offers, by topic.
        heard: messages by topic: log time [ns] and bytes.
        told: what it said otherwise, by operation.
    """

    def __init__(self, port: int) -> None:
        address, protocols = f"ws://127.0.0.1:{port}", [Subprotocol(PROTOCOL)]
        self._socket = connect(address, subprotocols=protocols, max_size=None, close_timeout=1.0)
        self.info: dict[str, Any] = json.loads(self._socket.recv(10.0))
        self.channels: dict[str, dict[str, Any]] = {}
        self.heard: dict[str, list[tuple[int, bytes]]] = defaultdict(list)
        self.told: dict[str, list[dict[str, Any]]] = defaultdict(list)
        self._names: dict[int, str] = {}
        self._assets: dict[int, bytes | None] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._socket.close()

    def say(self, **words: Any) -> None:
        """Send an operation."""
        self._socket.send(json.dumps(words))

    def send(self, data: bytes) -> None:
        """Send a binary one."""
        self._socket.send(data)

    def subscribe(self, *topics: str) -> None:
        """Look at topics; waits until they are offered."""
        for topic in topics:
            self.wait(partial(self.channels.__contains__, topic), f"{topic} is offered")
            self._names[self.channels[topic]["id"]] = topic
        wanted = [{"id": self.channels[topic]["id"], "channelId": self.channels[topic]["id"]} for topic in topics]
        self.say(op="subscribe", subscriptions=wanted)

    def unsubscribe(self, *topics: str) -> None:
        """Look away."""
        self.say(op="unsubscribe", subscriptionIds=[self.channels[topic]["id"] for topic in topics])

    def fetch(self, uri: str) -> bytes | None:
        """An asset; None: it is refused."""
        request = len(self._assets) + 1
        self.say(op="fetchAsset", uri=uri, requestId=request)
        self.wait(lambda: request in self._assets, f"an answer to {uri}")
        return self._assets[request]

    def wait(self, condition: Callable[[], Any], what: str, timeout: float = 30.0) -> None:
        """Let in what comes until the condition holds."""
        deadline = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < deadline, f"not within {timeout:g} s: {what}"
            try:
                self._take(self._socket.recv(0.1))
            except TimeoutError:
                continue

    def _take(self, received: str | bytes) -> None:
        if isinstance(received, bytes) and received[0] == _ASSET:
            request, failed, words = _ASSET_HEAD.unpack_from(received, 1)
            self._assets[request] = None if failed else received[1 + _ASSET_HEAD.size + words :]
            return
        if isinstance(received, bytes):
            assert received[0] == _MESSAGE_DATA
            subscription, stamp = _HEAD.unpack_from(received, 1)
            self.heard[self._names[subscription]].append((stamp, received[1 + _HEAD.size :]))
            return
        told = json.loads(received)
        self.told[told["op"]].append(told)
        if told["op"] == "advertise":
            self.channels.update({channel["topic"]: channel for channel in told["channels"]})


def schema_mentions(channel: dict[str, Any], name: str) -> bool:
    """Whether a channel's binary schema, base64 as JSON has it, contains a name."""
    return name.encode() in base64.b64decode(channel["schema"])
