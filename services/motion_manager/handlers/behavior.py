"""Requests for a behavior, and reactions that the devices demand."""

from bifrost import Received
from valor.common.behaviors import NO_LIMB, Behavior, Obstacle
from valor.common.messages import BehaviorReply, BehaviorRequest, DeviceStatus
from valor.common.topics import BEHAVIOR, DEVICES
from valor.motion_manager.handlers.handler import Handler, RequestHandler


class BehaviorHandler(RequestHandler[BehaviorRequest, BehaviorReply]):
    """Requests behaviors of the Behavior FSM for clients."""

    topic = BEHAVIOR

    def handle(self, request: BehaviorRequest, origin: str) -> BehaviorReply:
        fsm = self.components.fsm
        try:
            target = Behavior(request.behavior)
        except ValueError:
            reason = f"unknown behavior {request.behavior[:64]!r}; expected one of {', '.join(Behavior)}"
            return self._reject(origin, "unknown", reason, Obstacle.TRANSITION)
        if request.limbs:
            return self._freeze(target, [] if request.limbs == [NO_LIMB] else request.limbs, origin)
        if target is not fsm.behavior and (reason := self.components.authority.rejection(target)):
            return self._reject(origin, "no_robot", reason, Obstacle.CONDITION)
        if target is Behavior.FALL:
            self.components.landing.active = False
        verdict = fsm.request(target, self.components.conditions(), origin)
        if not verdict.accepted:
            return self._reject(origin, target, verdict.reason, verdict.obstacle)
        return BehaviorReply(True, fsm.behavior, verdict.reason, Obstacle.NONE)

    def _freeze(self, target: Behavior, limbs: list[str], origin: str) -> BehaviorReply:
        """Freeze exactly these limbs; the robot keeps its behavior."""
        components, behavior = self.components, self.components.fsm.behavior
        reason = components.upper_body.rejection(limbs) or components.authority.rejection(behavior)
        if target is not Behavior.FREEZE or (limbs and not behavior.balancing):
            reason = reason or f"limbs are frozen by freeze while the robot balances; it is in behavior {behavior}"
        if reason:
            return self._reject(origin, "limbs", reason, Obstacle.CONDITION)
        components.freeze(limbs)
        return BehaviorReply(True, behavior, "", Obstacle.NONE)

    def _reject(self, origin: str, kind: str, reason: str, obstacle: Obstacle) -> BehaviorReply:
        if obstacle is not Obstacle.WAIT:  # clients repeat such requests: no error
            self.components.rejections.add(BEHAVIOR.name, origin, kind, reason)
        return BehaviorReply(False, self.components.fsm.behavior, reason, obstacle)


class DevicesHandler(Handler[DeviceStatus]):
    """Forwards the demand of the Comms Manager; ignores that of a replayed bag."""

    topic = DEVICES
    after_motor = True

    def execute(self, received: Received[DeviceStatus], now: int) -> None:
        if received.origin == DEVICES.owner:
            self.components.device_reactions.receive(received.message)
