"""A stop of the running plan, on its way to the Motion Manager."""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import Future

import bifrost
from valor.common.messages import FootstepPlanReply
from valor.footstep_converter.execution import Execution
from valor.footstep_converter.motion_system import MotionSystem

RETRY = 0.5  # from a stop that was not answered to the next [s]

_log = logging.getLogger("footstep_converter")


class Stop:
    """Tells the Motion Manager to stop, until it answers or there is nothing left to stop.

    Attributes:
        wanted: it is to be told.
    """

    def __init__(self, motion: MotionSystem, wake: Callable[[], None]) -> None:
        """Nothing is to be stopped; ``wake`` is called, from any thread, when an answer has come."""
        self._motion, self._wake = motion, wake
        self._reply: Future[FootstepPlanReply] | None = None
        self._next = 0.0
        self.wanted = False

    def send(self, execution: Execution | None, now: float, *, held: bool) -> None:
        """See to what is new.

        Args:
            execution: of the running plan; None: none runs.
            now: monotonic [s].
            held: another request is on its way, behind which a stop waits.
        """
        if self._reply is not None and self._reply.done():
            self._answered(self._reply, execution, now)
            self._reply = None
        if self.wanted and self._reply is None and not held and now >= self._next:
            self.wanted = False
            self._reply = self._motion.request([], self._wake)
            if execution is not None:
                execution.stop_asked(now)

    def _answered(self, reply: Future[FootstepPlanReply], execution: Execution | None, now: float) -> None:
        try:
            answer = reply.result()
        except bifrost.Error as error:
            _log.warning("stop: %s", error)
            self.wanted = execution is not None
            self._next = now + RETRY
            return
        if answer.accepted:
            _log.info("the Motion Manager stops")
        else:
            _log.warning("the Motion Manager does not stop: %s", answer.reason)
            if execution is not None:
                execution.stop_refused()
