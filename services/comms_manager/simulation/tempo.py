"""How the simulated robot's time is to pass: on, paused, so many periods at a time, quicker or slower."""

from __future__ import annotations

import math

import bifrost
from valor.common.messages import TimeReply, TimeRequest
from valor.common.pacing import Pacer
from valor.common.topics import SIMULATED_TIME

AT_ONCE = 4  # requests that are answered in one look, at most
QUICKEST = 100.0  # of the wall's time
MOST_STEPS = 100_000


class Tempo:
    """Answers ``simulation/time``.

    Attributes:
        factor: of robot time to the wall's; 0: as fast as it goes.
    """

    def __init__(self, node: bifrost.Node, pacer: Pacer, factor: float) -> None:
        self._pacer, self.factor = pacer, factor
        self._halted = False
        self._steps = 0  # periods that pass all the same
        self._time = 0
        self._server = SIMULATED_TIME.server(node, self._answer)

    @property
    def paused(self) -> bool:
        """Whether the next period is not to begin."""
        return self._halted and self._steps == 0

    def serve(self, time: int) -> None:
        """Answer what waits, at that robot time [ns]."""
        self._time = time
        self._server.serve(AT_ONCE)

    def passed(self) -> None:
        """A period has."""
        self._steps = max(0, self._steps - 1)

    def resume(self) -> None:
        """Let time go on, if it was paused."""
        if self._halted:
            self._halted, self._steps = False, 0
            self._pacer.begin_anew(self.factor)

    def _answer(self, request: TimeRequest, origin: str) -> TimeReply:
        reason = self._obey(request.wanted, request.value)
        return TimeReply(not reason, self.paused, self.factor, self._time, reason)

    def _obey(self, wanted: str, value: float) -> str:
        """Do it, or say why not."""
        if wanted == "":
            return ""
        if not self._time:
            return "robot time has not begun: no Motor has come yet"
        if wanted == "pause":
            self._halted, self._steps = True, 0
        elif wanted == "resume":
            self.resume()
        elif wanted == "step":
            if not (1.0 <= value <= MOST_STEPS and value == math.floor(value)):
                return f"step: {value:g} control periods, expected 1 to {MOST_STEPS}"
            self._halted, self._steps = True, int(value)
            self._pacer.begin_anew(self.factor)
        elif wanted == "factor":
            if not 0.0 <= value <= QUICKEST:
                return f"factor: {value:g}, expected 0 to {QUICKEST:g} times the wall's time"
            self.factor = value
            self._pacer.begin_anew(value)
        else:
            return f"wanted: {wanted[:64]!r}, expected pause, resume, step or factor"
        return ""
