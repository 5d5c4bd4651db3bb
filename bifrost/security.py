"""Options of all sockets: CURVE, authentication of the network's keys, timeouts, sizes.

No socket is bound without CURVE: it excludes other processes, and libzmq 4.3.5 aborts the process on certain bytes sent
to a socket without it.
"""

import zmq
from zmq.utils import z85

from bifrost.grants import MEMBER
from bifrost.network import Network
from bifrost.wire import MAX_MESSAGE_SIZE

_ZAP_ENDPOINT = "inproc://zeromq.zap.01"  # fixed by ZeroMQ RFC 27
_ZAP_DOMAIN = b"bifrost"
MAX_SOCKETS = 4096  # of a context


def new_context() -> zmq.Context[zmq.Socket[bytes]]:
    """A context for some thousand sockets: one for each subscriber."""
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    context.set(zmq.MAX_SOCKETS, MAX_SOCKETS)
    return context


def _open(context: zmq.Context[zmq.Socket[bytes]], kind: int) -> zmq.Socket[bytes]:
    socket = context.socket(kind)
    socket.setsockopt(zmq.LINGER, 0)
    socket.setsockopt(zmq.MAXMSGSIZE, MAX_MESSAGE_SIZE)
    socket.setsockopt(zmq.HANDSHAKE_IVL, 5000)
    # TCP, not ZeroMQ's heartbeats, ends the connection to a computer that is switched off: with heartbeats libzmq 4.3.5
    # aborts a process whose queue is full (its issues 3937 and 4767). Without them, an engine whose input has stopped
    # ends only after it has delivered its messages, as both assertions require.
    socket.setsockopt(zmq.TCP_KEEPALIVE, 1)  # for idle connections
    socket.setsockopt(zmq.TCP_KEEPALIVE_IDLE, 1)
    socket.setsockopt(zmq.TCP_KEEPALIVE_INTVL, 1)
    socket.setsockopt(zmq.TCP_KEEPALIVE_CNT, 5)
    socket.setsockopt(zmq.TCP_MAXRT, 5000)  # for connections with unacknowledged data [ms]
    # Reconnect soon after an outage: Linux alone would wait longer and longer between attempts.
    socket.setsockopt(zmq.CONNECT_TIMEOUT, 2000)
    socket.setsockopt(zmq.RECONNECT_IVL, 50)
    socket.setsockopt(zmq.RECONNECT_IVL_MAX, 500)
    return socket


def listening_socket(context: zmq.Context[zmq.Socket[bytes]], kind: int, network: Network) -> zmq.Socket[bytes]:
    """A socket to bind; it admits holders of the network's client key, and owners, only."""
    socket = _open(context, kind)
    socket.setsockopt(zmq.CURVE_SERVER, 1)
    socket.setsockopt(zmq.CURVE_SECRETKEY, network.listening.secret)
    socket.setsockopt(zmq.ZAP_DOMAIN, _ZAP_DOMAIN)
    socket.setsockopt(zmq.ZAP_ENFORCE_DOMAIN, 1)  # without a gate, admit no connection
    return socket


def connecting_socket(context: zmq.Context[zmq.Socket[bytes]], kind: int, network: Network) -> zmq.Socket[bytes]:
    """A socket for ``connect``."""
    socket = _open(context, kind)
    socket.setsockopt(zmq.CURVE_SERVERKEY, network.server.public)
    socket.setsockopt(zmq.CURVE_PUBLICKEY, network.connecting.public)
    socket.setsockopt(zmq.CURVE_SECRETKEY, network.connecting.secret)
    return socket


def connect(socket: zmq.Socket[bytes], endpoint: str, key: bytes) -> None:
    """Connect a ``connecting_socket`` to an endpoint; no data is exchanged unless its owner has the public key."""
    socket.setsockopt(zmq.CURVE_SERVERKEY, key)
    socket.connect(endpoint)


class Gate:
    """Authenticates peers for libzmq (ZAP, ZeroMQ RFC 27). One for each context."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], network: Network) -> None:
        self.socket = context.socket(zmq.REP)
        self.socket.setsockopt(zmq.LINGER, 0)
        self.socket.bind(_ZAP_ENDPOINT)
        self._admitted = {z85.decode(network.client.public): MEMBER.encode()} | {
            z85.decode(key.encode()): owner.encode() for owner, key in network.grants.owners.items()
        }

    def answer(self) -> None:
        """Reply to all waiting requests."""
        while True:
            try:
                request = self.socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                return
            *_, key = request  # by libzmq, within this process
            user = self._admitted.get(key, b"")  # libzmq attaches it to every message of the peer
            status, text = (b"200", b"OK") if user else (b"400", b"not a member of this network")
            self.socket.send_multipart([b"1.0", request[1], status, text, user, b""])

    def close(self) -> None:
        """Close the socket; no peer is admitted afterwards."""
        self.socket.close()
