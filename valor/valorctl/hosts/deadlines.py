"""Start and stop calls with a deadline, served by supervisord in addition to its own calls.

TCP delivers a call after a cable is plugged in again, when its caller has already failed. Such a call is rejected.
"""

import time
from typing import Any

from supervisor.rpcinterface import SupervisorNamespaceRPCInterface
from supervisor.xmlrpc import Faults, RPCError


class DeadlineInterface:
    """XML-RPC calls by the supervisord's own monotonic clock [s]."""

    def __init__(self, supervisord: Any) -> None:
        self._calls = SupervisorNamespaceRPCInterface(supervisord)

    def clock(self) -> float:
        """Return the monotonic clock [s]."""
        return time.monotonic()

    def start(self, name: str, until: float) -> bool:
        """Start a process, unless the deadline has passed."""
        _require_in_time(until)
        return bool(self._calls.startProcess(name, False))

    def stop(self, name: str, until: float) -> bool:
        """Stop a process, unless the deadline has passed."""
        _require_in_time(until)
        return bool(self._calls.stopProcess(name, False))


def _require_in_time(until: float) -> None:
    if (late := time.monotonic() - until) > 0.0:
        raise RPCError(Faults.FAILED, f"arrived {late:.1f} s after its deadline; nothing was done")
