"""pyzmq alone, with CURVE: the least that an encrypted message takes."""

from __future__ import annotations

import zmq

from benchmarks.interprocess.transports import Place, pyzmq_bare


class Sender(pyzmq_bare.Sender):
    """A PUB that binds, a CURVE server; leaves the keys."""

    def secure(self, place: Place, payload: str, socket: pyzmq_bare.Socket) -> None:
        """Encrypt."""
        (public, secret), client = zmq.curve_keypair(), zmq.curve_keypair()
        socket.setsockopt(zmq.CURVE_SERVER, 1)
        socket.setsockopt(zmq.CURVE_SECRETKEY, secret)
        place.leave(f"{payload}.keys", " ".join(key.decode() for key in (public, *client)))


class Receiver(pyzmq_bare.Receiver):
    """A SUB that connects, a CURVE client."""

    def secure(self, place: Place, payload: str, socket: pyzmq_bare.Socket) -> None:
        """Encrypt."""
        server, public, secret = (key.encode() for key in place.find(f"{payload}.keys").split())
        socket.setsockopt(zmq.CURVE_SERVERKEY, server)
        socket.setsockopt(zmq.CURVE_PUBLICKEY, public)
        socket.setsockopt(zmq.CURVE_SECRETKEY, secret)
