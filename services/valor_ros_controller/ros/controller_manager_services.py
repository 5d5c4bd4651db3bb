"""Services of ros2_control's controller manager, under ``/controller_manager``, served in the ROS thread.

The controllers of controllers.yaml are loaded and configured from start to end; so loading and unloading are rejected,
with the reason in the log, as their responses have no text.
"""

import logging
from typing import Any

from controller_manager_msgs.msg import ControllerState
from controller_manager_msgs.srv import (
    ConfigureController,
    ListControllers,
    ListControllerTypes,
    LoadController,
    ReloadControllerLibraries,
    SwitchController,
    UnloadController,
)
from rclpy.node import Node

from valor.valor_ros_controller.core import Core

_log = logging.getLogger("controller_manager")

NAMESPACE = "controller_manager"
_REQUIRED = ("position", "velocity")  # of the state, by a trajectory controller
_LOADED = "controllers are those of controllers.yaml, loaded and configured from start to end"


class ControllerManagerServices:
    """Serves state read between two cycles of the update thread."""

    def __init__(self, node: Node, core: Core, *, rate: float, rejection: str = "") -> None:
        """``rate``: of the update loop [Hz]; ``rejection``: reason to reject every switch, empty if there is none."""
        self._switch, self._queue, self._hw = core.switch, core.queue, core.hw
        self._rate, self._rejection = round(rate), rejection
        self._known = {c.name: c for manager in core.switch.managers for c in manager.controllers.values()}
        for kind, name, callback in (
            (ListControllers, "list_controllers", self._list_controllers),
            (ListControllerTypes, "list_controller_types", self._list_types),
            (SwitchController, "switch_controller", self._switch_controllers),
            (ConfigureController, "configure_controller", self._configure),
            (LoadController, "load_controller", self._reject),
            (UnloadController, "unload_controller", self._reject),
            (ReloadControllerLibraries, "reload_controller_libraries", self._reject),
        ):
            node.create_service(kind, f"{NAMESPACE}/{name}", callback)

    def _active(self) -> frozenset[str]:
        """Active controllers at one moment."""
        return self._queue.call(lambda: frozenset(name for each in self._switch.managers for name in each.active))

    def _list_controllers(self, _: Any, response: Any) -> Any:
        active = self._active()
        for name, controller in self._known.items():
            joints = [self._hw.names[i] for i in getattr(controller, "joints", ())]
            commands = [f"{joint}/{i}" for joint in joints for i in getattr(controller, "command_interfaces", ())]
            response.controller.append(
                ControllerState(
                    name=name,
                    state="active" if name in active else "inactive",
                    type=controller.type,
                    update_rate=self._rate,
                    claimed_interfaces=commands if name in active else [],
                    required_command_interfaces=commands,
                    required_state_interfaces=[f"{joint}/{i}" for joint in joints for i in _REQUIRED],
                )
            )
        return response

    def _list_types(self, _: Any, response: Any) -> Any:
        response.types = sorted({controller.type for controller in self._known.values()})
        response.base_classes = ["controller_interface::ControllerInterface"] * len(response.types)
        return response

    def _switch_controllers(self, request: Any, response: Any) -> Any:
        activate, deactivate = list(request.activate_controllers), list(request.deactivate_controllers)
        try:
            if self._rejection:
                ok, message = False, self._rejection
            else:
                ok, message = self._queue.call(lambda: self._switch.switch(activate, deactivate, request.strictness))
        except TimeoutError as error:
            ok, message = False, str(error)
        if message:
            _log.warning("switch_controller: %s", message)
        response.ok, response.message = ok, message
        return response

    @staticmethod
    def _reject(request: Any, response: Any) -> Any:
        _log.warning("%s rejected: %s", type(request).__name__.removesuffix("_Request"), _LOADED)
        response.ok = False
        return response

    def _configure(self, request: Any, response: Any) -> Any:
        """Succeed for an inactive controller, which is configured already."""
        active = self._active()
        response.ok = request.name in self._known and request.name not in active
        if not response.ok:
            state = "is active" if request.name in active else "does not exist"
            _log.warning("configure_controller rejected: %s %s", request.name, state)
        return response
