"""Valor Escher Controller (VEC): the update loop over the three controller managers (thesis sections 3.5 and 4.2.1).

One cycle, at every second Proprioceptor::

    read ──► mode manager ──► switch controllers ──► joint manager ──► robot manager ──► rectify and write
      ▲      (control mode     if the mode says so   (trajectories)    (offsets)          (limits, one writer
      │       controller)                                                                  a joint)
    Proprioceptor, MotionState                                                             JointSetpoints
"""

from __future__ import annotations

import time

from valor_ros_controller.control_modes import ControlModeTable
from valor_ros_controller.controller_manager import Controller, ControllerManager
from valor_ros_controller.controllers.control_mode_controller import ControlModeController
from valor_ros_controller.controllers.joint_trajectory_controller import JointTrajectoryController
from valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface
from valor_ros_controller.valor_escher_interface import ValorEscherInterface

WAIT = 0.02
"""Without a Proprioceptor the loop still looks after modes and goals this often [s]."""


class ValorEscherController:
    """Runs the managers.

    Attributes:
        modes: the control mode manager, with the one controller ``mode_controller``.
        joints: the joint manager.
        robots: the robot manager.
        began: when the newest cycle began, its data having come [``time.perf_counter()``, s].
    """

    def __init__(
        self,
        *,
        table: ControlModeTable,
        hw: ValorEscherHWInterface,
        interface: ValorEscherInterface,
        mode_controller: ControlModeController,
        joint_controllers: list[JointTrajectoryController],
        robot_controllers: list[Controller],
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
        self.joints = ControllerManager("joint", joint_controllers)
        self.robots: ControllerManager[Controller] = ControllerManager("robot", robot_controllers)
        self.began = 0.0
        self._resets = 0
        self._last_time = 0
        self.modes.switch([mode_controller.name], hw, "start")
        for name, mode in table.modes.items():
            self.joints.check(mode.joint_controllers, f"control mode {name}: joint_controllers")
            self.robots.check(mode.robot_controllers, f"control mode {name}: robot_controllers")
            trial = ValorEscherHWInterface(hw.robot)
            for controller in mode.joint_controllers:
                trial.claim(controller, self.joints.controllers[controller].joints)

    def update(self) -> bool:
        """Wait for data and run one cycle; whether a measurement came."""
        measured = self._interface.read(WAIT)
        self.began = time.perf_counter()
        hw = self._hw
        went_back = hw.time < self._last_time
        self._last_time = hw.time
        self.modes.update(hw)
        self._switch(went_back)
        hw.command_offset.fill(0.0)
        self.joints.update(hw)
        self.robots.update(hw)
        if measured:
            self._interface.write()
        self._interface.report(self.mode_controller.report)
        return measured

    def _switch(self, went_back: bool) -> None:
        """Run the controllers of the active mode, none while the Motion System is silent."""
        hw, mode_controller, silent = self._hw, self.mode_controller, self._interface.silent
        name = mode_controller.active_mode
        anew = went_back or mode_controller.hard_resets != self._resets
        self._resets = mode_controller.hard_resets
        if silent or not name:
            hw.situation = reason = f"{silent or 'the Motion System'} is silent"
            self.joints.switch((), hw, reason)
            self.robots.switch((), hw, reason)
            return
        mode = self._table.modes[name]
        hw.situation = f"control mode {name}"
        reason = "robot time went back" if went_back else hw.situation
        if name == "none" and self._interface.behavior:
            reason = f"{reason}, the Motion System is in {self._interface.behavior}"
        self.joints.switch(mode.joint_controllers, hw, reason, anew=anew)
        self.robots.switch(mode.robot_controllers, hw, reason, anew=anew)
