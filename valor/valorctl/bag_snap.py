"""Asking a recorder that holds the last seconds to save them."""

from __future__ import annotations

import bifrost
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.messages import SnapReply, SnapRequest
from valor.common.topics import SNAP

TIMEOUT = 60.0  # many seconds are written in some [s]


def snap(instance: Instance) -> SnapReply:
    """Have the last seconds saved.

    Raises:
        ValorError: nobody records, or the recorder refuses; says why.
    """
    network = bifrost.Network.load(instance.network_file, instance.keys)
    with bifrost.Node("valorctl", network=network) as node:
        try:
            reply = SNAP.client(node).call(SnapRequest(), timeout=TIMEOUT)
        except bifrost.NoServerError:
            raise ValorError(f"nobody serves {SNAP.name}: the recorder does not run") from None
    if not reply.accepted:
        raise ValorError(f"not saved: {reply.reason}")
    return reply
