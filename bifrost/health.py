"""Whether a computer's daemon answers, and how it fares."""

from __future__ import annotations

import time

import msgspec
import zmq

from bifrost import directory as d
from bifrost.network import Network
from bifrost.security import connecting_socket


def daemon_alive(network: Network, timeout: float = 1.0) -> d.DaemonInfo | None:
    """Ask this computer's daemon how it fares; None when it does not answer within ``timeout`` [s]."""
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    socket = connecting_socket(context, zmq.DEALER, network)
    try:
        socket.connect(network.computer.daemon)
        socket.send(d.encode(d.Ask()))
        deadline = time.monotonic() + timeout
        while socket.poll(max(0, int((deadline - time.monotonic()) * 1000))):
            message = d.decode_from_daemon(socket.recv())
            if isinstance(message, d.DaemonInfo):
                return message
        return None
    except msgspec.DecodeError:
        return None
    finally:
        socket.close()
        context.term()
