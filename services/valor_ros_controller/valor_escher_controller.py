"""Valor Escher Controller (VEC): the update loop over the three controller managers (thesis sections 3.5 and 4.2.1).

One cycle, at every second Proprioceptor::

    read ──► mode manager ──► switch controllers ──► joint manager ──► robot manager ──► rectify and write
      ▲      (control mode     if the mode says so   (trajectories)    (pelvis,           (limits, one writer
      │       controller)                                               footsteps)         a joint)
    Proprioceptor, MotionState                                                             JointSetpoints,
                                                                                           PelvisSetpoint

What clients of the controller manager ask for is done between robot manager and rectification.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from valor.common.behaviors import ControlMode
from valor.valor_ros_controller.control_modes import ControlModeTable
from valor.valor_ros_controller.controller_manager import Controller, ControllerManager
from valor.valor_ros_controller.controller_switch import ControllerSwitch
from valor.valor_ros_controller.controllers.control_mode_controller import ControlModeController
from valor.valor_ros_controller.update_queue import UpdateQueue
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface
from valor.valor_ros_controller.valor_escher_interface import ValorEscherInterface

WAIT = 0.02
"""Without a Proprioceptor the loop still looks after modes and goals this often [s]."""


class ValorEscherController:
    """Runs the managers.

    Attributes:
        modes: the control mode manager, with the one controller ``mode_controller``.
        joints: the joint manager.
        robots: the robot manager.
        switch: switches controllers by hand. Update thread.
        queue: work for the update thread from others.
        began: when the newest cycle began, its data having come [``time.perf_counter()``, s].
    """

    def __init__(
        self,
        *,
        table: ControlModeTable,
        hw: ValorEscherHWInterface,
        interface: ValorEscherInterface,
        mode_controller: ControlModeController,
        joint_controllers: Sequence[Controller],
        robot_controllers: Sequence[Controller],
    ) -> None:
        """Put the managers together.

        Raises:
            ConfigurationError: the table of control modes names a controller that does not exist.
            JointClaimError: two controllers that a mode runs together write the same joint.
        """
        self._table = table
        self._hw = hw
        self._interface = interface
        self.mode_controller = mode_controller
        self.modes = ControllerManager("mode", [mode_controller])
        self.joints: ControllerManager[Controller] = ControllerManager("joint", joint_controllers)
        self.robots: ControllerManager[Controller] = ControllerManager("robot", robot_controllers)
        self.queue = UpdateQueue()
        self.began = 0.0
        self._resets = 0
        self._last_time = 0
        self.modes.enter("", [mode_controller.name], hw, "start", anew=True)
        self.switch = ControllerSwitch((self.modes, self.joints, self.robots), hw)
        for name, mode in table.modes.items():
            self.joints.check(mode.joint_controllers, f"control mode {name}: joint_controllers")
            self.robots.check(mode.robot_controllers, f"control mode {name}: robot_controllers")
            trial = ValorEscherHWInterface(hw.robot)
            for controller in (*mode.joint_controllers, *mode.robot_controllers):
                made: Any = {**self.joints.controllers, **self.robots.controllers}[controller]
                if made.command_interfaces:
                    trial.claim(controller, made.joints)

    def wait(self) -> bool:
        """Wait for the measurement that a cycle is due for, and store it; whether it came."""
        return self._interface.receive(WAIT)

    def update(self, measured: bool) -> None:
        """Run one cycle; set-points are sent if a measurement came."""
        self._interface.listen()
        self.began = time.perf_counter()
        hw = self._hw
        went_back = hw.time < self._last_time
        self._last_time = hw.time
        self.modes.update(hw)
        self._enter_mode(went_back)
        hw.command_offset.fill(0.0)
        self.joints.update(hw)
        self.robots.update(hw)
        self.queue.run()  # behind the controllers, so that a goal that came before a question is under way
        if measured:
            self._interface.write()
        self._interface.report(self.mode_controller.report)

    def _enter_mode(self, went_back: bool) -> None:
        """Run the controllers of the active mode, none while the Motion System is silent."""
        hw, mode_controller, silent = self._hw, self.mode_controller, self._interface.silent
        name = mode_controller.active_mode
        anew = went_back or mode_controller.hard_resets != self._resets
        self._resets = mode_controller.hard_resets
        if silent or not name:
            hw.situation = reason = f"{silent or 'the Motion System'} is silent"
            self.joints.enter("", (), hw, reason)
            self.robots.enter("", (), hw, reason)
            return
        mode = self._table.modes[name]
        hw.situation = f"control mode {name}"
        reason = "robot time went back" if went_back else hw.situation
        if name == ControlMode.NONE and self._interface.behavior:
            reason = f"{reason}, the Motion System is in {self._interface.behavior}"
        self.joints.enter(name, mode.joint_controllers, hw, reason, anew=anew)
        self.robots.enter(name, mode.robot_controllers, hw, reason, anew=anew)
