"""The services of ros2_control's controller manager, under ``/controller_manager``: what ``ros2 control`` asks for.

The controllers are those of controllers.yaml, loaded and configured at start and until the end; so loading, unloading
and the hardware's life cycle have nothing to do here, and say so in the log, for their answers have no text.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from builtin_interfaces.msg import Time
from controller_manager_msgs.msg import (
    ControllerManagerActivity,
    ControllerState,
    HardwareComponentState,
    HardwareInterface,
    NamedLifecycleState,
)
from controller_manager_msgs.srv import (
    CleanupController,
    ConfigureController,
    ListControllers,
    ListControllerTypes,
    ListHardwareComponents,
    ListHardwareInterfaces,
    LoadController,
    ReloadControllerLibraries,
    SetHardwareComponentState,
    SwitchController,
    UnloadController,
)
from lifecycle_msgs.msg import State
from rclpy.node import Node

from valor.valor_ros_controller.controller_switch import ControllerSwitch, SwitchAnswer
from valor.valor_ros_controller.ros.node import LATCHED
from valor.valor_ros_controller.ros.publisher import STATE_INTERFACES
from valor.valor_ros_controller.update_queue import UpdateQueue
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface

_log = logging.getLogger("controller_manager")

NAMESPACE = "controller_manager"
HARDWARE = "valor_escher_hw_interface"
HARDWARE_TYPE = "valor_ros_controller/ValorEscherHWInterface"
COMMAND_INTERFACES = ("position", "velocity", "acceleration")
_REQUIRED = ("position", "velocity")  # of the state, by a trajectory controller
_ACTIVE = State(id=State.PRIMARY_STATE_ACTIVE, label="active")
_INACTIVE = State(id=State.PRIMARY_STATE_INACTIVE, label="inactive")
_LOADED = "controllers are those of controllers.yaml, loaded and configured from start to end"


class ControllerManagerServices:
    """Answers in the ROS thread, with what it saw between two cycles of the update thread."""

    def __init__(
        self,
        node: Node,
        switch: ControllerSwitch,
        queue: UpdateQueue,
        hw: ValorEscherHWInterface,
        *,
        rate: float,
        stamp: Time,
        silent: Callable[[], str],
        refusal: str = "",
    ) -> None:
        """Offer the services.

        Args:
            node: the ROS node.
            switch: over all managers.
            queue: into the update thread.
            hw: whose claims.
            rate: of the update loop [Hz].
            stamp: robot time, kept up to date by its owner.
            silent: name of the process that the robot waits for; empty: none.
            refusal: why no controllers are switched; empty: they are.
        """
        self._refusal = refusal
        self._switch = switch
        self._queue = queue
        self._managers = switch.managers
        self._hw = hw
        self._rate = round(rate)
        self._stamp = stamp
        self._silent = silent
        self._known = {c.name: c for manager in self._managers for c in manager.controllers.values()}
        for kind, name, callback in (
            (ListControllers, "list_controllers", self._list_controllers),
            (ListControllerTypes, "list_controller_types", self._list_types),
            (ListHardwareComponents, "list_hardware_components", self._list_components),
            (ListHardwareInterfaces, "list_hardware_interfaces", self._list_interfaces),
            (SwitchController, "switch_controller", self._switch_controllers),
            (LoadController, "load_controller", self._refuse_to("load_controller")),
            (ConfigureController, "configure_controller", self._configure),
            (CleanupController, "cleanup_controller", self._refuse_to("cleanup_controller")),
            (UnloadController, "unload_controller", self._refuse_to("unload_controller")),
            (ReloadControllerLibraries, "reload_controller_libraries", self._refuse_to("reload_controller_libraries")),
            (SetHardwareComponentState, "set_hardware_component_state", self._set_component),
        ):
            node.create_service(kind, f"{NAMESPACE}/{name}", callback)
        self._activity = node.create_publisher(ControllerManagerActivity, f"{NAMESPACE}/activity", LATCHED)
        self._published: tuple[int, bool] | None = None

    # --- update thread --------------------------------------------------------------------------------------------

    def publish(self) -> None:
        """Publish ``~/activity`` on change."""
        present = (sum(manager.switches for manager in self._managers), bool(self._silent()))
        if present == self._published:
            return
        self._published = present
        active = self._active()
        message = ControllerManagerActivity(
            controllers=[
                NamedLifecycleState(name=name, state=_ACTIVE if name in active else _INACTIVE) for name in self._known
            ],
            hardware_components=[NamedLifecycleState(name=HARDWARE, state=self._hardware_state())],
        )
        message.header.stamp = self._stamp
        self._activity.publish(message)

    def _active(self) -> frozenset[str]:
        return frozenset(name for manager in self._managers for name in manager.active)

    def _look(self) -> tuple[frozenset[str], dict[int, str]]:
        """Who is active and who has claimed which joint, at one moment."""
        return self._active(), self._hw.claims

    # --- ROS thread -----------------------------------------------------------------------------------------------

    def _hardware_state(self) -> Any:
        return _INACTIVE if self._silent() else _ACTIVE

    def _list_controllers(self, _: Any, response: Any) -> Any:
        active, claims = self._queue.call(self._look)
        owners = set(claims.values())
        for name, controller in self._known.items():
            joints = [self._hw.names[i] for i in getattr(controller, "joints", ())]
            commands = [f"{joint}/{i}" for joint in joints for i in getattr(controller, "command_interfaces", ())]
            response.controller.append(
                ControllerState(
                    name=name,
                    state="active" if name in active else "inactive",
                    type=controller.type,
                    update_rate=self._rate,
                    claimed_interfaces=commands if name in owners else [],
                    required_command_interfaces=commands,
                    required_state_interfaces=[f"{joint}/{i}" for joint in joints for i in _REQUIRED],
                )
            )
        return response

    def _list_types(self, _: Any, response: Any) -> Any:
        response.types = sorted({controller.type for controller in self._known.values()})
        response.base_classes = ["controller_interface::ControllerInterface"] * len(response.types)
        return response

    def _interfaces(self) -> tuple[list[Any], list[Any]]:
        """All command and state interfaces."""
        _, claims = self._queue.call(self._look)
        available = not self._silent()

        def interfaces(kinds: tuple[str, ...], claimed: dict[int, str]) -> list[Any]:
            return [
                HardwareInterface(
                    name=f"{joint}/{kind}", data_type="double", is_available=available, is_claimed=i in claimed
                )
                for i, joint in enumerate(self._hw.names)
                for kind in kinds
            ]

        return interfaces(COMMAND_INTERFACES, claims), interfaces(STATE_INTERFACES, {})

    def _list_interfaces(self, _: Any, response: Any) -> Any:
        response.command_interfaces, response.state_interfaces = self._interfaces()
        return response

    def _list_components(self, _: Any, response: Any) -> Any:
        commands, states = self._interfaces()
        response.component = [
            HardwareComponentState(
                name=HARDWARE,
                type="system",
                rw_rate=self._rate,
                class_type=HARDWARE_TYPE,
                plugin_name=HARDWARE_TYPE,
                state=self._hardware_state(),
                command_interfaces=commands,
                state_interfaces=states,
            )
        ]
        return response

    def _switch_controllers(self, request: Any, response: Any) -> Any:
        activate, deactivate = list(request.activate_controllers), list(request.deactivate_controllers)
        try:
            if self._refusal:
                answer = SwitchAnswer(False, self._refusal)
            else:
                answer = self._queue.call(lambda: self._switch.switch(activate, deactivate, request.strictness))
        except TimeoutError as error:
            answer = SwitchAnswer(False, str(error))
        if answer.message:
            _log.warning("switch_controller: %s", answer.message)
        response.ok, response.message = answer.ok, answer.message
        return response

    def _refuse_to(self, verb: str) -> Callable[[Any, Any], Any]:
        def refuse(request: Any, response: Any) -> Any:
            _log.warning("%s refused: %s: %s", verb, getattr(request, "name", "all"), _LOADED)
            response.ok = False
            return response

        return refuse

    def _configure(self, request: Any, response: Any) -> Any:
        """An inactive controller is configured already; an active one cannot be."""
        active, _ = self._queue.call(self._look)
        response.ok = request.name in self._known and request.name not in active
        if not response.ok:
            state = "is active" if request.name in active else "does not exist"
            _log.warning("configure_controller refused: %s %s", request.name, state)
        return response

    def _set_component(self, request: Any, response: Any) -> Any:
        """The robot's own processes decide; asking for what is so already succeeds."""
        response.state = state = self._hardware_state()
        wanted = request.target_state
        response.ok = request.name == HARDWARE and (wanted.id == state.id or wanted.label == state.label)
        if not response.ok:
            _log.warning(
                "set_hardware_component_state refused: %s is %s while Comms Manager and Motion Manager run",
                request.name,
                state.label,
            )
        return response
