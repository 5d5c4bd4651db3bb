"""What the driver says of itself in ROS' diagnostics, as every service's statistics on Bifrost."""

from __future__ import annotations

from typing import Any

from valor.common.messages import Statistics

DRIVER = "hdt_driver"


def statistics(message: Any) -> Statistics | None:
    """The driver's statistics from a ``DiagnosticArray``; None: it does not speak of the driver."""
    for status in message.status:
        if status.name == DRIVER:
            values = {each.key: each.value for each in status.values}
            ready = status.message == "ready"
            try:
                return Statistics(
                    service=DRIVER,
                    pid=int(values["pid"]),
                    state="ready" if ready else "starting",
                    detail="" if ready else status.message,
                    cycles=int(values["cycles"]),
                    cycle_time_mean=float(values["cycle_time_mean"]),
                    cycle_time_max=float(values["cycle_time_max"]),
                    period_mean=float(values["period_mean"]),
                    period_max=float(values["period_max"]),
                    overruns=int(values["overruns"]),
                    cpu_percent=float(values["cpu_percent"]),
                    memory_mib=float(values["memory_mib"]),
                    drops=0,
                    rejected=int(values["rejected"]),
                )
            except (KeyError, ValueError):
                return None
    return None
