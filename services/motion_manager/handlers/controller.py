"""Requests for the controller of the balancing robot."""

from valor.common.messages import ControllerReply, ControllerRequest
from valor.common.topics import CONTROLLER
from valor.motion_manager.handlers.handler import RequestHandler


class ControllerHandler(RequestHandler[ControllerRequest, ControllerReply]):
    """Forwards requests to the exchange of controllers."""

    topic = CONTROLLER

    def handle(self, request: ControllerRequest, origin: str) -> ControllerReply:
        components = self.components
        reason = components.exchange.choose(request.controller, components.state)
        if reason:
            components.rejections.add(CONTROLLER.name, origin, "controller", reason)
        return ControllerReply(not reason, reason)
