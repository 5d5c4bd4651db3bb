"""A node's one background thread: tells the daemon what the node has, learns who else is there, guards the door.

Publishers, subscribers, servers and clients never talk to the daemon themselves. They announce an ``Entry`` here, and
those that connect hold a ``Watch``: the peers of a topic, renewed by the thread, which wakes the owner then.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Literal

import msgspec
import zmq

from bifrost import directory as d
from bifrost.network import Network
from bifrost.schema import Schema
from bifrost.security import Gate, connecting_socket

WAKE_ENDPOINT = "inproc://bifrost.wake"
# How long subscribers stay connected to the publishers of a node that is no longer in the table [s]: what it sent last
# may be on its way; a starved machine makes the living silent; a new daemon does not know everybody at once.
_KEPT: dict[d.Reason | Literal["forgotten"], float] = {"left": 1.0, "lost": 3.0, "silent": 10.0, "forgotten": 10.0}


@dataclass(frozen=True)
class Peer:
    """An entry of another node, and whose it is."""

    node: str
    incarnation: int
    started: int
    entry: d.Entry
    alive: bool  # as far as is known; False: gone, and what it sent last may still be on its way


@dataclass
class Watch:
    """The peers of one topic, newest node last. ``peers`` is replaced as a whole by the discovery thread."""

    kind: d.Kind
    topic: str
    notify: Callable[[], None]
    peers: tuple[Peer, ...] = ()


@dataclass
class _Departed:
    record: d.NodeRecord
    until: float
    alive: bool  # it may be


@dataclass
class _State:
    nodes: dict[int, d.NodeRecord] = field(default_factory=dict)
    departed: dict[int, _Departed] = field(default_factory=dict)
    epoch: int = 0
    version: int = -1


class Discovery:
    """See the module. All public methods may be called from any thread."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], network: Network, name: str) -> None:
        self._network = network
        self._name = name
        self.incarnation = secrets.randbits(63)
        self._started = time.time_ns()
        self._lock = threading.Lock()
        self._changed = threading.Condition(self._lock)
        self._entries: dict[int, tuple[d.Entry, tuple[Schema, ...]]] = {}
        self._next_key = 0
        self._watches: list[Watch] = []
        self._wakes: set[str] = set()  # topics whose subscribers must look at their watch
        self._dirty = False
        self._closing = False
        self._state = _State()
        self._heard = 0.0  # when the daemon last said anything
        self._context = context
        self._gate = Gate(context, network)
        self._wake = context.socket(zmq.XPUB)
        self._wake.setsockopt(zmq.LINGER, 0)
        self._wake.setsockopt(zmq.XPUB_VERBOSE, 1)
        self._wake.bind(WAKE_ENDPOINT)
        self._poke = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._daemon = connecting_socket(context, zmq.DEALER, network)
        self._daemon.connect(network.computer.daemon)
        self._thread = threading.Thread(target=self._run, name=f"bifrost-{name}", daemon=True)
        self._thread.start()

    # --- for publishers, subscribers, servers and clients ---------------------------------------------------------

    def announce(self, entry: d.Entry, schemas: Iterable[Schema]) -> int:
        """Tell the network of an entry; returns the key for ``withdraw``."""
        with self._lock:
            self._next_key += 1
            self._entries[self._next_key] = (entry, tuple(schemas))
            self._own_changed()
            return self._next_key

    def withdraw(self, key: int) -> None:
        """Take an entry back."""
        with self._lock:
            if self._entries.pop(key, None) is not None:
                self._own_changed()

    def watch(self, kind: d.Kind, topic: str, notify: Callable[[], None] | None = None) -> Watch:
        """Keep an eye on a topic's publishers or servers.

        Args:
            kind: what to look for.
            topic: its name.
            notify: called in the discovery thread after a change; by default the topic's subscribers are woken
                through the wake socket.
        """
        watch = Watch(kind, topic, notify or (lambda: self._wakes.add(topic)))
        with self._lock:
            watch.peers = self._peers(watch)
            self._watches.append(watch)
        return watch

    def unwatch(self, watch: Watch) -> None:
        """Let a topic go."""
        with self._lock:
            self._watches.remove(watch)

    def wait_change(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Wait until ``condition()``, looked at after every change of the table."""
        with self._changed:
            return self._changed.wait_for(condition, timeout)

    def records(self) -> list[d.NodeRecord]:
        """Every node known, this one included."""
        with self._lock:
            return list(self._state.nodes.values())

    def schema(self, digest: str) -> Schema | None:
        """The schema of a hash (hexadecimal), if any node has registered it."""
        with self._lock:
            departed = (each.record for each in self._state.departed.values())
            for record in (*self._state.nodes.values(), *departed):
                if digest in record.schemas:
                    return record.schemas[digest]
        return None

    @property
    def connected(self) -> bool:
        """Whether the daemon has been heard of within the last seconds."""
        return time.monotonic() - self._heard < d.NODE_TIMEOUT

    @property
    def registered(self) -> bool:
        """Whether this daemon's table has arrived."""
        return self._state.version >= 0 and self.connected

    def close(self) -> None:
        """Leave, and end the thread."""
        with self._lock:
            if self._closing:
                return
            self._closing = True
        self._poke_thread()
        self._thread.join()
        os.close(self._poke)

    # --- with the lock held ---------------------------------------------------------------------------------------

    def _own_changed(self) -> None:
        self._dirty = True
        self._state.nodes[self.incarnation] = self._record()
        self._refresh()
        self._poke_thread()

    def _record(self) -> d.NodeRecord:
        schemas = {s.digest().hex(): s for _, all_schemas in self._entries.values() for s in all_schemas}
        return d.NodeRecord(
            name=self._name,
            incarnation=self.incarnation,
            pid=os.getpid(),
            computer=self._network.computer.name,
            started=self._started,
            entries=tuple(entry for entry, _ in self._entries.values()),
            schemas=schemas,
        )

    def _peers(self, watch: Watch) -> tuple[Peer, ...]:
        records = [(record, True) for record in self._state.nodes.values()]
        records += [
            (each.record, each.alive)
            for each in self._state.departed.values()
            if each.alive or watch.kind == "publisher"
        ]
        records.sort(key=lambda pair: pair[0].started)
        return tuple(
            Peer(record.name, record.incarnation, record.started, entry, alive)
            for record, alive in records
            for entry in record.entries
            if entry.kind == watch.kind and entry.topic == watch.topic
        )

    def _refresh(self) -> None:
        for watch in self._watches:
            peers = self._peers(watch)
            if peers != watch.peers:
                watch.peers = peers
                watch.notify()
        self._changed.notify_all()

    # --- the thread -----------------------------------------------------------------------------------------------

    def _poke_thread(self) -> None:
        os.eventfd_write(self._poke, 1)

    def _run(self) -> None:
        poller = zmq.Poller()
        for socket in (self._gate.socket, self._daemon, self._wake, self._poke):
            poller.register(socket, zmq.POLLIN)
        next_heartbeat = 0.0
        try:
            while not self._closing:
                now = time.monotonic()
                if now >= next_heartbeat:
                    self._heartbeat()
                    next_heartbeat = now + d.HEARTBEAT_PERIOD
                ready = dict(poller.poll(max(1, int((next_heartbeat - now) * 1000) + 1)))
                if self._gate.socket in ready:
                    self._gate.answer()
                if self._poke in ready:
                    os.eventfd_read(self._poke)
                if self._wake in ready:
                    self._receive_subscriptions()
                if self._daemon in ready:
                    self._receive_from_daemon()
                self._forget_departed()
                self._register_if_dirty()
                self._send_wakes()
        finally:
            self._leave()

    def _heartbeat(self) -> None:
        self._send(d.Heartbeat(self.incarnation, self._state.epoch, self._state.version))

    def _register_if_dirty(self) -> None:
        with self._lock:
            if not self._dirty:
                return
            self._dirty = False
            record = self._record()
        self._send(d.Register(record))

    def _receive_subscriptions(self) -> None:
        """A subscriber has subscribed to the wake socket: wake it, lest it has missed an earlier wake."""
        while True:
            try:
                frame = self._wake.recv(zmq.NOBLOCK)
            except zmq.Again:
                return
            if frame[:1] == b"\x01":
                with self._lock:
                    self._wakes.add(frame[1:-1].decode())

    def _send_wakes(self) -> None:
        with self._lock:
            if not self._wakes:
                return
            wakes, self._wakes = self._wakes, set()
        for topic in wakes:
            self._wake.send(topic.encode() + b"\0", zmq.NOBLOCK)

    def _receive_from_daemon(self) -> None:
        while True:
            try:
                content = self._daemon.recv(zmq.NOBLOCK)
            except zmq.Again:
                return
            try:
                message = d.decode_from_daemon(content)
            except (msgspec.DecodeError, RecursionError):
                continue  # of another version
            self._heard = time.monotonic()
            with self._lock:
                self._take(message)
                self._changed.notify_all()

    def _take(self, message: d.FromDaemon) -> None:
        state = self._state
        if isinstance(message, d.Unknown):
            self._dirty = True
        elif isinstance(message, d.Table):
            new = {record.incarnation: record for record in message.nodes}
            reason: d.Reason | Literal["forgotten"] = "lost" if message.epoch == state.epoch else "forgotten"
            for incarnation, record in state.nodes.items():
                if incarnation not in new and incarnation != self.incarnation:
                    self._depart(record, reason)
            own = state.nodes.get(self.incarnation)
            state.nodes = new
            state.epoch, state.version = message.epoch, message.version
            if own is not None:
                new[self.incarnation] = own
            for incarnation in new:
                state.departed.pop(incarnation, None)
            self._refresh()
        elif isinstance(message, d.Update | d.Gone) and message.epoch == state.epoch:
            if message.version == state.version + 1:
                state.version = message.version
            # Otherwise something was missed; the next heartbeat carries our version and brings the table.
            if isinstance(message, d.Gone):
                record_gone = state.nodes.pop(message.incarnation, None)
                if record_gone is not None:
                    self._depart(record_gone, message.reason)
                elif message.incarnation in state.departed:
                    self._depart(state.departed[message.incarnation].record, message.reason)
            elif message.node.incarnation != self.incarnation:
                state.nodes[message.node.incarnation] = message.node
                state.departed.pop(message.node.incarnation, None)
            if self.incarnation not in state.nodes:
                state.nodes[self.incarnation] = self._record()
                self._dirty = True
            self._refresh()

    def _depart(self, record: d.NodeRecord, reason: d.Reason | Literal["forgotten"]) -> None:
        until = time.monotonic() + _KEPT[reason]
        self._state.departed[record.incarnation] = _Departed(record, until, reason in ("silent", "forgotten"))

    def _forget_departed(self) -> None:
        if not self._state.departed:
            return
        now = time.monotonic()
        with self._lock:
            over = [i for i, departed in self._state.departed.items() if now > departed.until]
            for incarnation in over:
                del self._state.departed[incarnation]
            if over:
                self._refresh()

    def _send(self, message: d.FromNode) -> None:
        # When the daemon has been away for long nothing more is queued: it asks for registration when it is back.
        with contextlib.suppress(zmq.Again):
            self._daemon.send(d.encode(message), zmq.NOBLOCK)

    def _leave(self) -> None:
        if self.connected:
            self._daemon.setsockopt(zmq.LINGER, 200)
            self._send(d.Leave(self.incarnation))
        self._daemon.close()
        self._wake.close()
        self._gate.close()
