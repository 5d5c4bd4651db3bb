"""Balance from the VRC: joint commands of a controller of ``valor.control``, which ``remote`` executes.

Before ``remote`` is to take over, the controller starts afresh every cycle, so that it does not integrate errors that
another controller causes.
"""

from __future__ import annotations

import logging
import time
from typing import Self

from valor.common.behaviors import LEGS, Locomotion
from valor.robot.description import RobotDescription
from valor.robot.motion_tables import REMOTE, WHOLE_BODY
from valor.valor_ros_controller.controller_manager import Controller, Resources
from valor.valor_ros_controller.controllers.configuration import ControllerConfig
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface

LONGEST = 0.02  # time step, after missed cycles [s]

_log = logging.getLogger("balance_controller")


class BalanceControllerConfig(ControllerConfig):
    """Balance controller."""

    controller: str = WHOLE_BODY  # also an installed one, or a policy of the robot


class BalanceController(Controller):
    """Commands legs and waist of a standing robot; of robots whose ``controllers`` list ``remote``."""

    type = "valor_ros_controller/BalanceController"
    command_interfaces = ("position", "velocity", "effort", "stiffness", "damping")
    config = BalanceControllerConfig

    def __init__(self, name: str, config: BalanceControllerConfig, hw: ValorEscherHWInterface) -> None:
        """Raises ConfigurationError: there is no such controller, or it does not command all of legs and waist."""
        from valor.valor_ros_controller.controllers.balancing import Balancing  # needed by robots with remote only

        self.name = name
        self.joints = hw.group_indices((*LEGS, "torso"))  # (k,) indices in the hardware interface's vectors
        self._balancing = Balancing(hw.robot, config.controller, self.joints)
        self._time = 0  # robot time of the last command [ns]
        self._running = False  # since the start for an exchange

    @classmethod
    def fits(cls, config: BalanceControllerConfig, robot: RobotDescription) -> bool:
        return REMOTE in robot.tables.controllers.names()[Locomotion.STAND]

    @classmethod
    def make(cls, name: str, config: BalanceControllerConfig, resources: Resources) -> Self:
        return cls(name, config, resources.hw)

    def start(self, hw: ValorEscherHWInterface) -> None:
        self.active = hw.estimate_needed = True
        self._running = False

    def stop(self, hw: ValorEscherHWInterface, reason: str) -> None:
        """Send no more commands: if ``remote`` is in control, the Whole-Body Controller takes over, then Soft Stop."""
        self.active = hw.estimate_needed = False
        hw.joint_command = None

    def update(self, hw: ValorEscherHWInterface) -> None:
        """Compute the command of a cycle with a new measurement and its estimate, while the robot stands."""
        measured, motion = hw.measured, hw.motion
        if not self.active or measured is None or motion is None or measured.time == self._time:
            return
        if motion.locomotion != Locomotion.STAND:
            self._running = False
            return
        if motion.time != measured.time:
            return
        began, dt = time.perf_counter(), min(max(1e-9 * (measured.time - self._time), 0.0), LONGEST)
        self._time = measured.time
        try:
            command = self._balancing.update(measured, motion, dt, fresh=not self._running)
        except Exception:
            _log.exception("%s failed: it sends nothing until it is deactivated and activated", self.name)
            self.stop(hw, "it failed")
            return
        exchange = hw.balance_controllers
        self._running = exchange is not None and REMOTE in (exchange.active, exchange.pending)
        if command is not None:
            hw.joint_command = self.joints, command, time.perf_counter() - began
