"""``motion_manager/behavior``: requests for a behavior, accepted or refused with the reason."""

from __future__ import annotations

from collections.abc import Callable
from typing import Self

from valor.common.behaviors import Behavior, Obstacle
from valor.common.messages import BehaviorReply, BehaviorRequest
from valor.common.topics import BEHAVIOR
from valor.motion_manager.handlers.handler import RequestHandler
from valor.motion_manager.handlers.rejections import Rejections
from valor.motion_manager.parts import Parts
from valor.motion_manager.states.behavior_fsm import BehaviorFsm, Conditions


class BehaviorHandler(RequestHandler[BehaviorRequest, BehaviorReply]):
    """Asks the Behavior FSM on behalf of a client."""

    topic = BEHAVIOR

    def __init__(
        self,
        fsm: BehaviorFsm,
        rejections: Rejections,
        conditions: Callable[[], Conditions],
        out_of_control: Callable[[Behavior], str],
    ) -> None:
        """Make the handler.

        Args:
            fsm: the Behavior FSM.
            rejections: where refusals are counted.
            conditions: gives what the robot's condition has against transitions.
            out_of_control: gives why the Motion Manager has no robot to bring into a behavior now, or an empty text.
        """
        self._fsm = fsm
        self._rejections = rejections
        self._conditions = conditions
        self._out_of_control = out_of_control

    @classmethod
    def of(cls, parts: Parts) -> Self:
        """The one of a Motion Manager."""
        return cls(parts.fsm, parts.rejections, parts.conditions, parts.custody.refusal)

    def handle(self, request: BehaviorRequest, origin: str) -> BehaviorReply:
        """Answer a request of the node ``origin``."""
        try:
            target = Behavior(request.behavior)
        except ValueError:
            return self._refuse(
                origin,
                "unknown",
                f"unknown behavior {request.behavior[:64]!r}; expected one of {', '.join(Behavior)}",
                Obstacle.TRANSITION,
            )
        if target is not self._fsm.behavior and (reason := self._out_of_control(target)):
            return self._refuse(origin, "no_robot", reason, Obstacle.CONDITION)
        verdict = self._fsm.request(target, self._conditions(), origin)
        if not verdict.accepted:
            return self._refuse(origin, target, verdict.reason, verdict.obstacle)
        return BehaviorReply(True, self._fsm.behavior, verdict.reason, Obstacle.NONE)

    def _refuse(self, origin: str, kind: str, reason: str, obstacle: Obstacle) -> BehaviorReply:
        if obstacle is not Obstacle.WAIT:  # whoever asks until it passes does nothing wrong
            self._rejections.add(BEHAVIOR.name, origin, kind, reason)
        return BehaviorReply(False, self._fsm.behavior, reason, obstacle)
