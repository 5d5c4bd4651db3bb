"""The loop that both ends of the link have in common: datagrams in and out, ROS attended to between."""

from __future__ import annotations

import time
from collections.abc import Callable

from valor.link.carrier import Carrier
from valor.link.end import End
from valor.ros.node import RosSide
from valor.service import Context, quiet_collector

PERIOD = 0.01  # [s]
GRACE = 5.0  # for the first word of the other end [s]


def tell(context: Context, end: End, began: float) -> None:
    """Say whether the other end is heard; ``began``: this one, monotonic [s]."""
    now = time.monotonic()
    silent = end.silent(now) > context.settings.link.lost_after
    why = end.session.strange or ("the other end of the link is not heard" if silent else "")
    state = "ready" if not why else "starting" if now - began < GRACE else "degraded"
    context.statistics.state(state, why)


def serve(context: Context, side: RosSide, end: End, carrier: Carrier, turn: Callable[[float], None]) -> None:
    """Until told to stop.

    Args:
        context: of the process.
        side: its node.
        end: of the link.
        carrier: of the end's datagrams.
        turn: what this end does with what has come and been attended to; is given the monotonic time [s].
    """
    began = time.monotonic()
    tell(context, end, began)
    side.life.tell(True)
    quiet_collector()
    while not context.stopping.is_set():
        carrier.wait(PERIOD)
        carrier.turn(time.monotonic())
        side.attend()
        turn(time.monotonic())
        tell(context, end, began)
        context.statistics.rejected = sum(end.refused.values())
        context.statistics.idle()
