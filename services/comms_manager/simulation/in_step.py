"""The Valor ROS Controller in lockstep: the world waits for its cycles, so that set-points do not stall in robot time.

A convenience and no safety: who does not keep up within the bound is gone on without, until it does a cycle again.
"""

from __future__ import annotations

import logging
import time

import bifrost
from valor.common.messages import ControllerCycle

PATIENCE = 1.0  # of one wait for a cycle; then the world goes on without [s]
SLACK = 1  # periods that a cycle may be late: it and the Motion Manager's tick then share the cores
SLOWEST = 1000  # periods between two cycles that are believed
_LOOK_EVERY = 0.05  # while waiting: whether anybody does cycles at all [s]
_log = logging.getLogger("comms_manager")


class InStep:
    """Keeps the world from running ahead of a controller's cycles.

    Attributes:
        waits_timed_out: how often a wait gave up.
        remark: who is gone on without, and why; empty: nobody.
    """

    def __init__(self, cycles: bifrost.Subscriber[ControllerCycle]) -> None:
        """Nobody is waited for before its first cycle of this world."""
        self._cycles = cycles
        self._first = self._done = 0
        self._every = 1
        self._followed, self._origin = False, ""
        self.waits_timed_out = 0
        self.remark = ""

    def wait(self, current: int) -> float:
        """Wait until the cycle that is due has been done, ``SLACK`` periods late at most, or the controller is gone.

        Args:
            current: sequence of the newest Proprioceptor.

        Returns:
            The time spent waiting [s].
        """
        self._first = self._first or current
        self._take(self._cycles.latest(), current)
        if not self._followed or current - self._done < self._every + SLACK:
            return 0.0
        began = time.perf_counter()
        deadline = began + PATIENCE
        while current - self._done >= self._every + SLACK:
            remaining = deadline - time.perf_counter()
            received = self._cycles.receive(min(remaining, _LOOK_EVERY)) if remaining > 0.0 else None
            self._take(received, current)
            if remaining <= 0.0:
                self.waits_timed_out += 1
                self._leave(f"no cycle within {PATIENCE:g} s")
                break
            if received is None and not self._cycles.publishers:
                self._leave("it is gone")
                break
        return time.perf_counter() - began

    def _take(self, received: bifrost.Received[ControllerCycle] | None, current: int) -> None:
        """Note a cycle, if it is one of this world."""
        if received is None:
            return
        cycle = received.message
        if not self._first <= cycle.proprioceptor_sequence <= current or not 1 <= cycle.every <= SLOWEST:
            return
        self._done, self._every = cycle.proprioceptor_sequence, cycle.every
        if not self._followed:
            self._followed, self._origin, self.remark = True, received.origin, ""
            _log.info("in lockstep with %s, which does a cycle every %d periods", received.origin, cycle.every)

    def _leave(self, why: str) -> None:
        self._followed = False
        self.remark = f"{self._origin} is not waited for: {why}"
        _log.warning("%s; robot time goes on without it", self.remark)
