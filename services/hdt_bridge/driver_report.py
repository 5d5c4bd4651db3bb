"""What the driver says of itself in ROS' diagnostics, as every service's statistics on Bifrost."""

from __future__ import annotations

from typing import Any

import msgspec

from valor.common.messages import Statistics

DRIVER = "hdt_driver"


def statistics(message: Any) -> Statistics | None:
    """The driver's statistics from a ``DiagnosticArray``; None: it does not speak of the driver."""
    for status in message.status:
        if status.name == DRIVER:
            ready = status.message == "ready"
            values: dict[str, Any] = {each.key: each.value for each in status.values}
            values |= {"service": DRIVER, "drops": 0}
            values |= {"state": "ready", "detail": ""} if ready else {"state": "starting", "detail": status.message}
            try:
                return msgspec.convert(
                    [values[name] for name in Statistics.__struct_fields__], Statistics, strict=False
                )
            except (KeyError, msgspec.ValidationError):
                return None
    return None
