"""The background thread of a node: registers its entries with the daemon, receives the table, authenticates peers.

Publishers, subscribers, servers and clients do not communicate with the daemon. They announce an ``Entry`` here; those
that connect hold a ``Watch``, the peers of a topic, which the thread updates before it wakes the owner.
"""

import logging
import os
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import NamedTuple, Protocol

import msgspec
import zmq

from bifrost import directory as d
from bifrost import security
from bifrost.clocks import OWN_CLOCK, OtherClock
from bifrost.messages import Schema
from bifrost.neighbors import Neighbors, Watch
from bifrost.network import Network
from bifrost.security import Gate
from bifrost.table_cache import recall
from bifrost.wakes import Wakes

# Minimum interval between registrations, each of which is sent to all nodes, for each entry of the node [s].
_REST = 1e-4
_RECALL_AFTER = 0.3  # time without a daemon, after which the table on disk is read [s]
_WARNINGS = 20  # maximum number of logged rejections
_log = logging.getLogger("bifrost")


class Closable(Protocol):
    """Owner of an entry, closed with its node."""

    def close(self) -> None:
        """Release all resources, and withdraw the entry."""


class _Announced(NamedTuple):
    entry: d.Entry
    schemas: dict[str, Schema]  # by hash
    owner: Closable | None


class Discovery:
    """See the module. All public methods are thread-safe."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], network: Network, name: str, recall: bool) -> None:
        self.network, self.name = network, name
        self.daemon_silent = f"bifrostd at {network.computer.daemon} does not respond"  # message for the user
        self.incarnation = secrets.randbits(63)  # of no other node, nor of a later run of this one
        here = network.computer.name
        self._bare_record = d.NodeRecord(name, self.incarnation, os.getpid(), here, time.monotonic_ns())
        self._lock = threading.Lock()
        self._changed = threading.Condition(self._lock)
        self._announced: dict[int, _Announced] = {}  # by key
        self._next_key = 0
        self._tasks: deque[Callable[[], None]] = deque()  # for the thread
        self._attended: dict[int, Callable[[], None]] = {}
        self._poller = zmq.Poller()
        self._dirty = False
        self._next_registration = 0.0
        self._closing = False
        self._neighbors = Neighbors(here)
        self._clocks: dict[str, OtherClock] = {here: OWN_CLOCK}
        self._refused: set[str] = set()  # logged
        self._heard = 0.0  # time of the daemon's latest message, monotonic [s]
        self._recall_at = time.monotonic() + _RECALL_AFTER if recall else float("inf")
        self._context = context
        self._gate = Gate(context, network)
        self.wakes = Wakes(context)
        self._poke = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._daemon = self.connecting_socket(zmq.DEALER)
        security.connect(self._daemon, network.computer.daemon, network.daemon_key)
        self._thread = threading.Thread(target=self._run, name=f"bifrost-{name}", daemon=True)
        self._thread.start()

    def listening_socket(self, kind: int) -> zmq.Socket[bytes]:
        """A socket to bind."""
        return security.listening_socket(self._context, kind, self.network)

    def connecting_socket(self, kind: int) -> zmq.Socket[bytes]:
        """A socket to connect."""
        return security.connecting_socket(self._context, kind, self.network)

    def connect(self, socket: zmq.Socket[bytes], entry: d.Entry) -> None:
        """Connect a socket to an entry's endpoint."""
        security.connect(socket, entry.endpoint, entry.key.encode() or self.network.server.public)

    def announce(self, entry: d.Entry, schemas: Iterable[Schema], owner: Closable | None = None) -> int:
        """Register an entry; returns the key to ``withdraw`` it. Else ``owner`` is closed with the node."""
        announced = _Announced(entry, {schema.digest().hex(): schema for schema in schemas}, owner)
        with self._lock:
            self._next_key += 1
            self._announced[self._next_key] = announced
            self._neighbors.add_own(self._bare_record, entry)
            self._own_changed()
            return self._next_key

    def withdraw(self, key: int) -> None:
        """Remove an entry."""
        with self._lock:
            announced = self._announced.pop(key, None)
            if announced is not None:
                self._neighbors.remove_own(announced.entry)
                self._own_changed()

    def watch(self, kind: d.Kind, topic: str, notify: Callable[[], None] | None = None) -> Watch:
        """Watch a topic's publishers or servers.

        ``notify`` is called after a change, with the lock held; by default it wakes the topic's subscribers.
        """
        watch = Watch(kind, topic, notify or (lambda: self.wakes.add(topic)))
        with self._lock:
            self._neighbors.watch(watch)
        return watch

    def unwatch(self, watch: Watch) -> None:
        """End a watch."""
        with self._lock:
            self._neighbors.unwatch(watch)

    def clock(self, computer: str) -> OtherClock:
        """The clock of a computer; the thread updates its offset."""
        with self._lock:
            return self._clocks.setdefault(computer, OtherClock())

    def wake(self, topic: str) -> None:
        """Wake the topic's subscribers of this node."""
        self.wakes.add(topic)
        self._poke_thread()

    def attend(self, descriptor: int, callback: Callable[[], None]) -> None:
        """Have the thread call ``callback`` whenever a descriptor is readable."""
        self._tasks.append(lambda: self._register(descriptor, callback))
        self._poke_thread()

    def leave_alone(self, descriptor: int, then: Callable[[], None]) -> None:
        """End ``attend``; the thread then calls ``then``, which may close the descriptor."""
        self._tasks.append(lambda: self._unregister(descriptor, then))
        self._poke_thread()

    def wait_change(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Wait until ``condition()``, evaluated after every change of the table."""
        with self._changed:
            return self._changed.wait_for(condition, timeout)

    def records(self) -> list[d.NodeRecord]:
        """All nodes, this one included."""
        with self._lock:
            return [self._record(), *self._neighbors.nodes.values()]

    def schema(self, digest: str) -> Schema | None:
        """The schema of a hash (hexadecimal), if a node has registered it."""
        with self._lock:
            own = (each.schemas[digest] for each in self._announced.values() if digest in each.schemas)
            return next(own, None) or self._neighbors.schema(digest)

    @property
    def owners(self) -> list[Closable]:
        """Owners of the present entries."""
        with self._lock:
            return [each.owner for each in self._announced.values() if each.owner is not None]

    @property
    def connected(self) -> bool:
        """True if the daemon has sent a message within the last seconds."""
        return time.monotonic() - self._heard < d.NODE_TIMEOUT

    @property
    def registered(self) -> bool:
        """True if this daemon's table has arrived."""
        return self._neighbors.version >= 0 and self.connected

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
        self._refresh()
        self._poke_thread()

    def _record(self) -> d.NodeRecord:
        announced = self._announced.values()
        schemas = {digest: schema for each in announced for digest, schema in each.schemas.items()}
        return msgspec.structs.replace(
            self._bare_record, entries=tuple(each.entry for each in announced), schemas=schemas
        )

    def _refresh(self) -> None:
        self._neighbors.refresh()
        self._changed.notify_all()

    # --- the thread -----------------------------------------------------------------------------------------------

    def _poke_thread(self) -> None:
        os.eventfd_write(self._poke, 1)

    def _run(self) -> None:
        for socket in (self._gate.socket, self._daemon, self.wakes.socket, self._poke):
            self._poller.register(socket, zmq.POLLIN)
        next_heartbeat = 0.0
        try:
            while not self._closing:
                now = time.monotonic()
                if now >= next_heartbeat:
                    self._heartbeat()
                    next_heartbeat = now + d.HEARTBEAT_PERIOD
                if now >= self._recall_at:
                    self._recall()
                until = min(next_heartbeat, self._recall_at)
                if self._dirty:
                    until = min(until, self._next_registration)
                ready = dict(self._poller.poll(max(0, int((until - now) * 1000)) + 1))
                if self._gate.socket in ready:
                    self._gate.answer()
                if self._poke in ready:
                    os.eventfd_read(self._poke)
                if self.wakes.socket in ready:
                    self.wakes.receive()
                if self._daemon in ready:
                    self._receive_from_daemon()
                for descriptor in ready.keys() & self._attended.keys():
                    self._attended[descriptor]()
                self._run_tasks()
                self._forget_departed()
                self._register_if_dirty()
                self.wakes.send()
        finally:
            self._run_tasks()
            self._leave()

    def _run_tasks(self) -> None:
        while self._tasks:
            self._tasks.popleft()()

    def _register(self, descriptor: int, callback: Callable[[], None]) -> None:
        self._attended[descriptor] = callback
        self._poller.register(descriptor, zmq.POLLIN)
        callback()  # the descriptor reports later events only

    def _unregister(self, descriptor: int, then: Callable[[], None]) -> None:
        if self._attended.pop(descriptor, None) is not None:
            self._poller.unregister(descriptor)
        then()

    def _heartbeat(self) -> None:
        self._send(d.Heartbeat(self.incarnation, self._neighbors.epoch, self._neighbors.version))

    def _register_if_dirty(self) -> None:
        now = time.monotonic()
        with self._lock:
            if not self._dirty or now < self._next_registration:
                return
            self._dirty = False
            record = self._record()
        self._next_registration = now + _REST * len(record.entries)
        if not self._send(d.Register(record)):
            self._dirty = True
            self._next_registration = now + d.HEARTBEAT_PERIOD

    def _receive_from_daemon(self) -> None:
        for message in d.from_daemon(self._daemon):
            self._heard = time.monotonic()
            with self._lock:
                self._take(message)
                self._changed.notify_all()

    def _take(self, message: d.FromDaemon) -> None:
        neighbors = self._neighbors
        if isinstance(message, d.Clocks):
            for computer, ahead in message.ahead.items():
                clock = self._clocks.setdefault(computer, OtherClock())
                clock.ahead, clock.known = ahead, True
            return
        if isinstance(message, d.Unknown):
            self._dirty = True
        elif isinstance(message, d.Table):
            others = (self._sifted(record) for record in message.nodes if record.incarnation != self.incarnation)
            neighbors.replace(others, message.epoch, message.version)
        elif isinstance(message, d.Update | d.Gone) and message.epoch == neighbors.epoch:
            if message.version == neighbors.version + 1:
                neighbors.version = message.version
            # Otherwise an update was lost; the reply to the next heartbeat, with our version, is the table.
            if isinstance(message, d.Gone):
                neighbors.depart(message.incarnation, message.reason)
                self._dirty |= message.incarnation == self.incarnation  # this node still runs
            elif message.node.incarnation != self.incarnation:
                neighbors.put(self._sifted(message.node))
        self._refresh()

    def _recall(self) -> None:
        """Without a daemon, use the nodes in the last one's table."""
        self._recall_at = float("inf")
        if not self._heard:
            with self._lock:
                for record in recall(self.network):
                    self._neighbors.put(self._sifted(record))
                self._refresh()

    def _sifted(self, record: d.NodeRecord) -> d.NodeRecord:
        """A record without unauthorised entries. The daemon removes them, but is not trusted."""
        record, refusals = record.sifted(self.network.grants)
        for refusal in refusals:
            if refusal not in self._refused and len(self._refused) < _WARNINGS:
                self._refused.add(refusal)
                _log.warning("%s", refusal)
        return record

    def _forget_departed(self) -> None:
        if self._neighbors.any_departed:
            with self._lock:
                self._neighbors.forget_departed()
                self._refresh()

    def _send(self, message: d.ToDaemon) -> bool:
        """False when the queue is full after a long absence of the daemon; the caller retries later."""
        try:
            self._daemon.send(d.encode(message), zmq.NOBLOCK)
        except zmq.Again:
            return False
        return True

    def _leave(self) -> None:
        if self.connected:
            self._daemon.setsockopt(zmq.LINGER, 200)
            self._send(d.Leave(self.incarnation))
        self._daemon.close()
        self.wakes.socket.close()
        self._gate.close()
