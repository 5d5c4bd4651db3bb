"""Choice of the Motion System's controller over ROS: services as of a controller manager ``/motion_manager``."""

import logging
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from controller_manager_msgs.msg import ControllerState
from controller_manager_msgs.srv import ListControllers, SwitchController
from rclpy.node import Node
from valor_msgs.msg import ControllerStatus as RosControllerStatus

import bifrost
from valor.common import balance_controllers
from valor.common.balance_controllers import allowed, in_control
from valor.common.messages import ControllerRequest, ControllerStatus
from valor.common.topics import CONTROLLER, CONTROLLERS
from valor.ros.controllers import STATUS
from valor.ros.mirror import MirrorPublisher
from valor.ros.node import STEADY
from valor.valor_ros_controller.ros.node import LATCHED

NAMESPACE = "motion_manager"
TYPE = "valor/BalanceController"
_PERIOD = 0.1  # between two polls of the status [s]
_log = logging.getLogger("balance_controllers")


class BalanceControllers:
    """Services and status. Callbacks run in the ROS thread; requests in others, which wait for the replies."""

    def __init__(
        self, ros: Node, node: bifrost.Node, behavior: Callable[[], str], *, rate: float, rejection: str = ""
    ) -> None:
        """Open the interfaces.

        ``behavior`` returns the robot's present one, from any thread; ``rate``: of the controllers [Hz]; ``rejection``:
        reason to reject every switch, empty if there is none.
        """
        self._ros, self._behavior, self._rate, self._rejection = ros, behavior, round(rate), rejection
        self._clients = [CONTROLLER.client(node) for _ in range(2)]  # of the two threads
        self._threads = [ThreadPoolExecutor(1, thread_name_prefix="balance_controllers") for _ in self._clients]
        self._statuses = CONTROLLERS.subscriber(node)
        self._awaited = CONTROLLERS.subscriber(node, queue=balance_controllers.QUEUE)  # of the second thread
        self._status: ControllerStatus | None = None
        self._publisher = MirrorPublisher(ros, RosControllerStatus, STATUS, LATCHED)
        self._busy = self._closing = False
        ros.create_timer(_PERIOD, self._poll, clock=STEADY)
        ros.create_service(ListControllers, f"{NAMESPACE}/list_controllers", self._list)
        # rclpy responds when a callback returns, but an exchange takes a while: this callback returns the request.
        switch = ros.create_service(SwitchController, f"{NAMESPACE}/switch_controller", lambda request, _: request)
        self._respond, switch.send_response = switch.send_response, self._receive

    def choose(self, name: str) -> None:
        """Request a controller without waiting; the Motion Manager publishes a rejection. From any thread."""
        self._threads[0].submit(self._choose, name)

    def close(self) -> None:
        """End the threads, at the latest when a request in progress has timed out."""
        self._closing = True
        for thread, client in zip(self._threads, self._clients, strict=True):
            thread.shutdown(cancel_futures=True)
            client.close()

    def _poll(self) -> None:
        if (received := self._statuses.latest()) is not None:
            self._status = received.message
            self._publisher.publish(received)

    def _in_control(self) -> str:
        return in_control(self._status, self._behavior()) if self._status else ""

    def _list(self, _: Any, response: Any) -> Any:
        status, active = self._status, self._in_control()
        for name in sorted({*status.stand, *status.walk}) if status else ():
            state = "active" if name == active else "inactive"
            response.controller.append(ControllerState(name=name, state=state, type=TYPE, update_rate=self._rate))
        return response

    def _choose(self, name: str) -> None:
        try:
            self._clients[0].call(ControllerRequest(name), balance_controllers.REPLY_TIMEOUT)
        except bifrost.Error as error:
            _log.warning("controller %s not requested: %s", name, error)

    def _receive(self, request: Any, header: Any) -> None:
        if reason := self._rejection or ("another switch is in progress; try again" if self._busy else ""):
            self._finish(reason, header)
        else:
            self._busy = True
            self._threads[1].submit(self._serve, request, header)

    def _serve(self, request: Any, header: Any) -> None:
        try:
            reason = self._switch(request)
        except (bifrost.Error, ConnectionAbortedError) as error:
            reason = str(error)
        self._ros.executor.create_task(self._finish, reason, header, True)
        self._ros.executor.wake()

    def _finish(self, reason: str, header: Any, busy: bool = False) -> None:
        """Respond, in the ROS thread; ``busy``: a switch was in progress for it."""
        self._busy &= not busy
        if reason:
            _log.warning("%s/switch_controller: %s", NAMESPACE, reason)
        self._respond(SwitchController.Response(ok=not reason, message=reason), header)

    def _switch(self, request: Any) -> str:
        """Exchange the controllers; returns the reason if that has not happened.

        Exactly one controller is active: an activation deactivates the others.
        """
        status, behavior = self._status, self._behavior()
        if status is None:
            return f"no {CONTROLLERS.name} received; expected a Motion Manager that is ready: valorctl status"
        wrong = set(request.deactivate_controllers) - {self._in_control()}
        if wrong and request.strictness == request.STRICT:
            return f"deactivate {', '.join(sorted(wrong))}: not active; expected {self._in_control() or 'none'}"
        names = allowed(status, behavior)
        known = f"expected one of {', '.join(sorted(names))}" if names else "expected a robot that stands or walks"
        if len(request.activate_controllers) != 1:
            return f"activate {len(request.activate_controllers)} controllers in {behavior or 'no behavior'}: {known}"
        (name,) = request.activate_controllers
        if name not in names:
            return f"activate {name[:64]!r} in {behavior or 'no behavior'}: {known}; see valorctl controller"
        return balance_controllers.exchange(self._clients[1], self._awaited, name, self._check)

    def _check(self) -> None:
        if self._closing:
            raise ConnectionAbortedError("valor_ros_controller ends")
