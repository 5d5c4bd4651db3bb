"""Session and loop of both ends of the link."""

import time
from collections.abc import Callable

from valor.common import topics
from valor.common.errors import ConfigurationError
from valor.common.instance import Instance
from valor.common.linking import NAMES
from valor.link.endpoint import LinkEndpoint
from valor.link.fields import FIELDS
from valor.link.session import Session, fingerprint, shared_secret
from valor.link.udp_transport import UdpTransport
from valor.robot.description import RobotDescription
from valor.ros.node import RosSide
from valor.service import Context, quiet_collector

PERIOD = 0.01  # [s]
CALLBACKS = 100  # in one turn: all that wait, so that their order can be restored
START_TIMEOUT = 5.0  # for the first datagram of the other end [s]


def create_session(instance: Instance, name: str, robot: RobotDescription) -> Session:
    """Session of the end ``name``, with a secret derived from both ends' Bifrost keys.

    Raises ConfigurationError: the instance's network has no keys of both ends.
    """
    secret = instance.link_key.read_bytes() if instance.link_key.exists() else _secret_of_processes(instance, name)
    print_ = fingerprint(repr(FIELDS).encode(), robot.file.read_bytes(), robot.model_file.read_bytes())
    return Session(secret, name == NAMES[0], print_)


def _secret_of_processes(instance: Instance, name: str) -> bytes:
    """Secret where one host has issued the keys of both ends."""
    network = topics.network(instance, name)
    other = NAMES[1 - NAMES.index(name)]
    public = network.grants.owners.get(other)
    if public is None or network.own is None:
        raise ConfigurationError(f"{instance.network_file}: no key of {other}; `valorctl up --link DOMAIN` issues it")
    return shared_secret(network.own.secret, public.encode())


def report_state(context: Context, end: LinkEndpoint, started: float) -> None:
    """Report whether the other end is connected; ``started``: start of this end, monotonic [s]."""
    now = time.monotonic()
    silent = end.silence(now) > context.settings.link.lost_after
    reason = end.session.mismatch or ("no datagrams of the other end of the link" if silent else "")
    state = "ready" if not reason else "starting" if now - started < START_TIMEOUT else "degraded"
    context.statistics.state(state, reason)


def serve(
    context: Context, side: RosSide, end: LinkEndpoint, transport: UdpTransport, turn: Callable[[float], None]
) -> None:
    """Serve until the process is stopped; ``turn``: one cycle of this end, called with the monotonic time [s]."""
    started = time.monotonic()
    report_state(context, end, started)
    side.life.set_ready(True)
    quiet_collector()
    while not context.stopping.is_set():
        transport.wait(PERIOD)
        transport.turn(time.monotonic())
        side.serve_pending(CALLBACKS)
        turn(time.monotonic())
        report_state(context, end, started)
        context.statistics.rejected = end.rejected
        context.statistics.idle()
