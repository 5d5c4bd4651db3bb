"""Serves pushes on the simulated robot."""

from __future__ import annotations

import math

import bifrost
from valor.common.messages import PushReply, PushRequest
from valor.common.topics import PUSH
from valor.simulation.plant import Plant

AT_ONCE = 4  # requests that are answered in one period, at most
DEFAULT_DURATION = 0.1  # where the request says 0 [s]
LONGEST = 2.0  # [s]
LARGEST = 500.0  # [N·s]


class PushServer:
    """Answers ``simulation/push``.

    Attributes:
        refused: how many requests were refused.
    """

    def __init__(self, node: bifrost.Node, plant: Plant) -> None:
        self._plant = plant
        self._time = 0
        self._server = PUSH.server(node, self._push)
        self.refused = 0

    def serve(self, time: int) -> None:
        """Answer what waits, at that robot time [ns]; 0: robot time has not begun."""
        self._time = time
        self._server.serve(AT_ONCE)

    def _push(self, request: PushRequest, origin: str) -> PushReply:
        reason = self._fault(request)
        if reason:
            self.refused += 1
        else:
            self._plant.push(request.impulse_in_world, request.duration or DEFAULT_DURATION, request.body)
        return PushReply(accepted=not reason, time=self._time, reason=reason)

    def _fault(self, request: PushRequest) -> str:
        """Why a push is refused; empty if it is not."""
        impulse, duration = request.impulse_in_world, request.duration
        if impulse.size != 3:
            return f"impulse_in_world: {impulse.size} numbers, expected 3"
        magnitude = math.sqrt(float(impulse.dot(impulse)))
        if not magnitude <= LARGEST:  # NaN is refused too
            return f"impulse_in_world: {magnitude:g} N·s, expected at most {LARGEST:g}"
        if not 0.0 <= duration <= LONGEST:
            return f"duration: {duration:g} s, expected up to {LONGEST:g}, or 0 for {DEFAULT_DURATION:g}"
        if request.body and not self._plant.has_body(request.body):
            return f"body: {request.body[:64]!r}, expected one of the robot's model"
        if self._plant.pushed:
            return "an earlier push still acts"
        if not self._time:
            return "robot time has not begun: no Motor has come yet"
        return ""
