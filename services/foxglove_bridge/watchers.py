"""Who looks at what: told by the server in threads of its own, asked by the loop."""

from __future__ import annotations

import threading

from foxglove.websocket import ChannelView, Client, ServerListener


class Watchers(ServerListener):
    """Channels by the clients that look at them."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._clients: dict[int, set[int]] = {}  # by channel
        self._new: set[int] = set()

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Somebody looks at a channel."""
        with self._lock:
            self._clients.setdefault(channel.id, set()).add(client.id)
            self._new.add(channel.id)

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        """He does no longer, or is gone."""
        with self._lock:
            self._clients.get(channel.id, set()).discard(client.id)

    def look(self) -> tuple[frozenset[int], frozenset[int]]:
        """The channels that somebody looks at, and those of them that somebody began to since it was last asked."""
        with self._lock:
            watched = frozenset(channel for channel, clients in self._clients.items() if clients)
            new, self._new = watched & self._new, set()
        return watched, new

    @property
    def clients(self) -> int:
        """How many look at anything."""
        with self._lock:
            return len(set[int]().union(*self._clients.values()))
