"""What a verb asks of a running system in one request: a push, or the last seconds saved."""

from __future__ import annotations

import math

import numpy as np

from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.messages import (
    MarkReply,
    MarkRequest,
    PushReply,
    PushRequest,
    SnapReply,
    SnapRequest,
    TimeReply,
    TimeRequest,
)
from valor.common.topics import MARK, PUSH, SIMULATED_TIME, SNAP
from valor.valorctl.node import ask

PUSH_DURATION = 0.1  # [s]
SNAP_TIMEOUT = 60.0  # many seconds are written in some [s]


def push(instance: Instance, impulse_in_world: tuple[float, float, float], body: str = "") -> PushReply:
    """Push a body of the simulated robot, the chest unless named, with an impulse [N·s] over ``PUSH_DURATION``.

    Raises:
        ValorError: not finite, refused, or there is no simulation.
    """
    if not all(map(math.isfinite, impulse_in_world)):
        raise ValorError(f"impulse {impulse_in_world}: expected finite numbers [N·s]")
    request = PushRequest(impulse_in_world=np.array(impulse_in_world), duration=PUSH_DURATION, body=body)
    reply = ask(instance, PUSH, request, 2.0, "only a simulated robot can be pushed")
    if not reply.accepted:
        raise ValorError(f"push refused: {reply.reason}")
    return reply


def simulated_time(instance: Instance, wanted: str, value: float = 0.0) -> TimeReply:
    """Let simulated time pass otherwise; ``wanted`` and ``value`` as of ``TimeRequest``.

    Raises:
        ValorError: refused, or there is no simulation.
    """
    reply = ask(instance, SIMULATED_TIME, TimeRequest(wanted, value), 2.0, "only a simulated robot's time can be led")
    if not reply.accepted:
        raise ValorError(f"{wanted} refused: {reply.reason}")
    return reply


def snap(instance: Instance) -> SnapReply:
    """Have a recorder that holds the last seconds save them.

    Raises:
        ValorError: nobody records, or the recorder refuses; says why.
    """
    reply = ask(instance, SNAP, SnapRequest(), SNAP_TIMEOUT, "the recorder does not run")
    if not reply.accepted:
        raise ValorError(f"not saved: {reply.reason}")
    return reply


def mark(instance: Instance, text: str) -> MarkReply:
    """Note this moment in the recording.

    Raises:
        ValorError: nobody records, or the recorder refuses; says why.
    """
    reply = ask(instance, MARK, MarkRequest(text), 2.0, "the recorder does not run")
    if not reply.accepted:
        raise ValorError(f"not marked: {reply.reason}")
    return reply
