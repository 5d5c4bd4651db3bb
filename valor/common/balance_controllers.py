"""Clients' choice of the controller of the balancing robot."""

from __future__ import annotations

import time
from collections.abc import Callable

import bifrost
from valor.common.behaviors import Behavior, Locomotion
from valor.common.messages import ControllerReply, ControllerRequest, ControllerStatus

QUEUE = 32  # of the statuses for ``exchange``
REPLY_TIMEOUT = 2.0  # [s]
LONGEST = 20.0  # of an exchange; the Motion Manager waits up to 3 s of robot time for its conditions [s]
_PERIOD = 0.1  # of checks [s]


def allowed(status: ControllerStatus, behavior: str) -> list[str]:
    """Controllers that may control the robot in a behavior, the chosen one first; empty if none can be chosen there."""
    lists = {Locomotion.STAND: status.stand, Locomotion.WALK: status.walk}
    return lists.get(Behavior(behavior).locomotion, []) if behavior in tuple(Behavior) else []


def in_control(status: ControllerStatus, behavior: str) -> str:
    """Controller that balances the robot in a behavior; empty if none does."""
    return status.active if behavior in tuple(Behavior) and Behavior(behavior).balancing else ""


def exchange(
    client: bifrost.Client[ControllerRequest, ControllerReply],
    statuses: bifrost.Subscriber[ControllerStatus],
    name: str,
    check: Callable[[], None] = lambda: None,
) -> str:
    """Request a controller and wait until it is in control; returns the reason why it is not, or an empty text.

    The present behavior must allow it. ``statuses`` has ``QUEUE``; ``check`` is called while waiting and may raise.
    Raises ``bifrost.Error`` without a reply.
    """
    statuses.drain()
    requested = time.monotonic_ns()
    reply = client.call(ControllerRequest(name), timeout=REPLY_TIMEOUT)
    if not reply.accepted:
        return reply.reason
    deadline = time.monotonic() + LONGEST
    while time.monotonic() < deadline:
        check()
        if (received := statuses.receive(timeout=_PERIOD)) is None:
            continue
        status = received.message
        first = name in (status.stand[0], status.walk[0])
        if first and status.active == name:
            return ""
        if not first and received.stamp > requested:  # an older one may be the latched one
            return status.reason
    return f"not in control within {LONGEST:g} s"
