"""What every socket is given: CURVE, the gate that admits the network's keys, time limits, sizes.

Nothing is ever bound without CURVE: it keeps strangers out, and libzmq 4.3.5 aborts the process on certain bytes sent
to a socket without it.
"""

from __future__ import annotations

import errno
import resource

import zmq
from zmq.utils import z85

from bifrost.errors import Error
from bifrost.grants import MEMBER
from bifrost.network import Network
from bifrost.wire import MAX_MESSAGE_SIZE

_ZAP_ENDPOINT = "inproc://zeromq.zap.01"  # fixed by ZeroMQ RFC 27
_ZAP_DOMAIN = b"bifrost"
_CURVE_KEY_LENGTH = 32
MAX_SOCKETS = 4096  # of a context


def new_context() -> zmq.Context[zmq.Socket[bytes]]:
    """A context that has room for a subscriber to each of some thousand topics."""
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    context.set(zmq.MAX_SOCKETS, MAX_SOCKETS)
    return context


def _open(context: zmq.Context[zmq.Socket[bytes]], kind: int) -> zmq.Socket[bytes]:
    try:
        socket = context.socket(kind)
    except zmq.ZMQError as error:
        if error.errno != errno.EMFILE:
            raise
        descriptors = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
        raise Error(
            f"cannot open another socket: {error.strerror}; at most {MAX_SOCKETS} a node, and {descriptors} file "
            "descriptors (RLIMIT_NOFILE), of which each takes two"
        ) from None
    socket.setsockopt(zmq.LINGER, 0)
    socket.setsockopt(zmq.MAXMSGSIZE, MAX_MESSAGE_SIZE)
    socket.setsockopt(zmq.HANDSHAKE_IVL, 5000)
    # A computer that is gone without a word is let go by TCP, and no connection ever by ZeroMQ's heartbeats: with them
    # libzmq 4.3.5 aborts a process whose queue is full (its issues 3937 and 4767). Without, an engine whose input has
    # stopped ends only after it has handed over what it had, which is what both of the assertions want.
    socket.setsockopt(zmq.TCP_KEEPALIVE, 1)  # of a connection on which nothing is sent
    socket.setsockopt(zmq.TCP_KEEPALIVE_IDLE, 1)
    socket.setsockopt(zmq.TCP_KEEPALIVE_INTVL, 1)
    socket.setsockopt(zmq.TCP_KEEPALIVE_CNT, 5)
    socket.setsockopt(zmq.TCP_MAXRT, 5000)  # of one on which something is, and nothing is acknowledged [ms]
    # A link that is back is used at once: Linux alone would wait longer and longer between attempts.
    socket.setsockopt(zmq.CONNECT_TIMEOUT, 2000)
    socket.setsockopt(zmq.RECONNECT_IVL, 50)
    socket.setsockopt(zmq.RECONNECT_IVL_MAX, 500)
    return socket


def listening_socket(context: zmq.Context[zmq.Socket[bytes]], kind: int, network: Network) -> zmq.Socket[bytes]:
    """A socket to bind: admits holders of the network's client key, and owners, alone.

    Raises:
        Error: there are too many already.
    """
    socket = _open(context, kind)
    socket.setsockopt(zmq.CURVE_SERVER, 1)
    socket.setsockopt(zmq.CURVE_SECRETKEY, network.listening.secret)
    socket.setsockopt(zmq.ZAP_DOMAIN, _ZAP_DOMAIN)
    socket.setsockopt(zmq.ZAP_ENFORCE_DOMAIN, 1)  # no gate, no admittance
    return socket


def connecting_socket(context: zmq.Context[zmq.Socket[bytes]], kind: int, network: Network) -> zmq.Socket[bytes]:
    """A socket for ``connect``.

    Raises:
        Error: there are too many already.
    """
    socket = _open(context, kind)
    socket.setsockopt(zmq.CURVE_SERVERKEY, network.server.public)
    socket.setsockopt(zmq.CURVE_PUBLICKEY, network.connecting.public)
    socket.setsockopt(zmq.CURVE_SECRETKEY, network.connecting.secret)
    return socket


def connect(socket: zmq.Socket[bytes], endpoint: str, key: bytes) -> None:
    """Connect to whoever listens there and has a key; nobody else gets or says a word.

    Args:
        socket: a ``connecting_socket``.
        endpoint: of the other.
        key: its public one. It holds for this connection, and whenever that is made anew.
    """
    socket.setsockopt(zmq.CURVE_SERVERKEY, key)
    socket.connect(endpoint)


class Gate:
    """Answers libzmq's question whether a peer is admitted, and who it is (ZAP, ZeroMQ RFC 27). One a context."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], network: Network) -> None:
        self.socket = context.socket(zmq.REP)
        self.socket.setsockopt(zmq.LINGER, 0)
        self.socket.bind(_ZAP_ENDPOINT)
        self._admitted = {z85.decode(network.client.public): MEMBER.encode()} | {
            z85.decode(key.encode()): owner.encode() for owner, key in network.grants.owners.items()
        }

    def answer(self) -> None:
        """Answer all questions that wait."""
        while True:
            try:
                request = self.socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                return
            self._answer(request)

    def _answer(self, request: list[bytes]) -> None:
        request_id = request[1] if len(request) > 1 else b""
        admitted = (
            len(request) == 7
            and request[0] == b"1.0"
            and request[5] == b"CURVE"
            and len(request[6]) == _CURVE_KEY_LENGTH
            and request[6] in self._admitted
        )
        status, text = (b"200", b"OK") if admitted else (b"400", b"not a member of this network")
        user = self._admitted[request[6]] if admitted else b""  # told with every message that the peer sends
        self.socket.send_multipart([b"1.0", request_id, status, text, user, b""])

    def close(self) -> None:
        """Close the socket; from now on nobody is admitted."""
        self.socket.close()
