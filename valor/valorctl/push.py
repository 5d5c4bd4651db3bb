"""Pushing the simulated robot."""

from __future__ import annotations

import math

import numpy as np

import bifrost
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.messages import PushReply, PushRequest
from valor.common.topics import PUSH

DURATION = 0.1  # [s]


def push(instance: Instance, impulse_in_world: tuple[float, float, float]) -> PushReply:
    """Push the chest with an impulse [N·s] spread over ``DURATION``.

    Raises:
        ValorError: not finite, refused, or there is no simulation.
    """
    if not all(map(math.isfinite, impulse_in_world)):
        raise ValorError(f"impulse {impulse_in_world}: expected finite numbers [N·s]")
    network = bifrost.Network.load(instance.network_file, instance.keys)
    with bifrost.Node("valorctl", network=network) as node:
        request = PushRequest(impulse_in_world=np.array(impulse_in_world), duration=DURATION)
        try:
            reply = PUSH.client(node).call(request, timeout=2.0)
        except bifrost.NoServerError:
            raise ValorError(f"nobody serves {PUSH.name}: only a simulated robot can be pushed") from None
    if not reply.accepted:
        raise ValorError(f"push refused: {reply.reason}")
    return reply
