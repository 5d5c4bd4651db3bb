"""Commands on ROS topics that a cable has held back: refused, for what comes late nobody wants any more."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Mapping
from typing import Any

LATE = 1.0  # a command from another computer that was sent longer ago is refused [s]
TOLD = 1.0  # between two words of one topic [s]
_log = logging.getLogger("ros")

Info = Mapping[str, int | None]
"""What rclpy tells of a message."""


def timely(topic: str, callback: Callable[[Any, Info], object], *, others: bool) -> Callable[[Any, Info], object]:
    """A callback that passes on what was sent at most ``LATE`` ago, and logs what was not.

    Without ``others``, computers that may command, it is the callback itself.

    How long a message was on its way is by the wall clocks of both computers, which are chrony's or PTP's to keep:
    where the sender's is behind by more, all of its commands are refused. Messages without stamps are passed on.
    """
    if not others:
        return callback
    told = -math.inf

    def pass_on(message: Any, info: Info) -> None:
        nonlocal told
        sent, received = info.get("source_timestamp"), info.get("received_timestamp")
        late = 1e-9 * (received - sent) if sent and received else 0.0
        if late <= LATE:
            callback(message, info)
        elif time.monotonic() - told >= TOLD:
            told = time.monotonic()
            _log.warning(
                "%s: refused: came %.1f s after it was sent, by both computers' wall clocks; expected at most %g s",
                *(topic, late, LATE),
            )

    return pass_on
