"""The Valor ROS Controller without ROS, put together: the Valor Escher Controller (VEC, thesis sections 3.5 and 4.2.1).

One cycle, at every second Proprioceptor::

    read ──► mode manager ──► switch controllers ──► joint manager ──► robot manager ──► rectify and write
      ▲      (control mode     if the mode says so   (trajectories)    (pelvis,           (limits, one writer
      │       controller)                                               footsteps)         a joint)
    Proprioceptor, MotionState                                                             JointSetpoints,
                                                                                           PelvisSetpoint

What clients of the controller manager ask for is done between robot manager and rectification. Who runs the core waits
for a measurement, then updates; what lies between is his own.

Two tables say what there is: ``control_modes.yaml`` and ``controllers.yaml``.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import bifrost
from valor.common.behaviors import NOTHING_TO_LEAD, ControlMode
from valor.robot.description import RobotDescription
from valor.valor_ros_controller.behavior_commander import Commander
from valor.valor_ros_controller.control_modes import ControlModeTable
from valor.valor_ros_controller.controller_manager import ControllerManager
from valor.valor_ros_controller.controller_switch import ControllerSwitch
from valor.valor_ros_controller.controllers.configuration import ControllersTable
from valor.valor_ros_controller.controllers.control_mode_controller import ControlModeController
from valor.valor_ros_controller.controllers.footstep_controller import FootstepController
from valor.valor_ros_controller.controllers.joint_trajectory_controller import JointTrajectoryController
from valor.valor_ros_controller.controllers.tracking_controller import TrackingController
from valor.valor_ros_controller.update_queue import UpdateQueue
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface
from valor.valor_ros_controller.valor_escher_interface import ValorEscherInterface

WAIT = 0.02
"""Without a Proprioceptor the loop still looks after modes and goals this often [s]."""


class Core:
    """All parts, each made of those before it, and the update loop over them.

    Attributes:
        modes: the table of control modes.
        table: of controllers.
        hw: state and commands.
        interface: the Motion System's side.
        mode_controller: the control modes' state machine, alone in the control mode manager.
        trajectories: name → trajectory controller, those of joints first.
        tracking: name → controller that only follows the robot.
        footsteps: the footstep controller.
        joints, robots: the joint manager and the robot manager.
        switch: switches controllers by hand. Update thread.
        queue: work for the update thread from others.
        began: when the newest cycle began, its data having come [``time.perf_counter()``, s].
    """

    def __init__(
        self,
        robot: RobotDescription,
        node: bifrost.Node,
        commander: Callable[[Callable[[], None]], Commander],
        *,
        decimation: int,
        silence_timeout: float,
        refusal: str = "",
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Put it together.

        Args:
            robot: its description.
            node: to the Bifrost network.
            commander: makes what asks for behaviors; takes what it is to call, from any thread, after each answer.
            decimation: a cycle is due at every n-th Proprioceptor.
            silence_timeout: a process that publishes nothing for so long is silent [s].
            refusal: why every control mode that is asked for is refused; empty: it is not.
            clock: monotonic [s].

        Raises:
            ConfigurationError: a table is wrong.
            JointClaimError: two controllers that a mode runs together write the same joint.
        """
        everything = ControllersTable.load()
        self.table = table = everything.of(robot)
        lacking = "" if table.manipulate else NOTHING_TO_LEAD
        self.modes = modes = ControlModeTable.load().without(everything.names - table.names, lacking)
        self.hw = hw = ValorEscherHWInterface(robot)
        self.interface = ValorEscherInterface(node, commander, hw, decimation, silence_timeout, clock=clock)
        self.mode_controller = ControlModeController(modes, self.interface, refusal)
        self.trajectories = {
            name: JointTrajectoryController(name, config, hw, modes.running(name))
            for name, config in (table.joint_controllers | table.robot_controllers).items()
        }
        self.tracking = {
            name: TrackingController(name, config, hw) for name, config in table.tracking_controllers.items()
        }
        self.footsteps = FootstepController(self.interface)
        self._modes = ControllerManager("mode", [self.mode_controller])
        self.joints = ControllerManager(
            "joint", [*(self.trajectories[name] for name in table.joint_controllers), *self.tracking.values()]
        )
        self.robots = ControllerManager(
            "robot", [self.footsteps, *(self.trajectories[name] for name in table.robot_controllers)]
        )
        self.switch = ControllerSwitch((self._modes, self.joints, self.robots), hw)
        self.queue = UpdateQueue()
        self.began = 0.0
        self._resets = 0
        self._last_time = 0
        self._check_modes()
        self._modes.enter("", [self.mode_controller.name], hw, "start", anew=True)

    def _check_modes(self) -> None:
        """Whether the controllers that a mode runs exist, and no two of them write the same joint."""
        for name, mode in self.modes.modes.items():
            self.joints.check(mode.joint_controllers, f"control mode {name}: joint_controllers")
            self.robots.check(mode.robot_controllers, f"control mode {name}: robot_controllers")
            trial = ValorEscherHWInterface(self.hw.robot)
            for controller in (*mode.joint_controllers, *mode.robot_controllers):
                if writer := self.trajectories.get(controller):
                    trial.claim(controller, writer.joints)

    @property
    def rejected(self) -> int:
        """How many messages, control modes and trajectories were refused."""
        trajectories = sum(controller.refusals.count for controller in self.trajectories.values())
        return self.interface.rejected + self.mode_controller.refusals.count + trajectories

    def wait(self) -> bool:
        """Wait for the measurement that a cycle is due for, and store it; whether it came."""
        return self.interface.receive(WAIT)

    def update(self, measured: bool) -> None:
        """Run a cycle; set-points are sent if it is ``measured``, as ``wait`` said."""
        self.interface.listen()
        self.began = time.perf_counter()
        hw = self.hw
        went_back = hw.time < self._last_time
        self._last_time = hw.time
        self._modes.update(hw)
        self._enter_mode(went_back)
        self.mode_controller.answer()
        hw.command_offset.fill(0.0)
        self.joints.update(hw)
        self.robots.update(hw)
        self.queue.run()  # behind the controllers, so that a goal that came before a question is under way
        if measured:
            self.interface.write()
            self.interface.tell_cycle()
        self.interface.report(self.mode_controller.report)

    def _enter_mode(self, went_back: bool) -> None:
        """Run the controllers of the active mode, none while the Motion System is silent."""
        hw, mode_controller, silent = self.hw, self.mode_controller, self.interface.silent
        name = mode_controller.active_mode
        anew = went_back or mode_controller.hard_resets != self._resets
        self._resets = mode_controller.hard_resets
        if silent or not name:
            hw.situation = reason = f"{silent or 'the Motion System'} is silent"
            self.joints.enter("", (), hw, reason)
            self.robots.enter("", (), hw, reason)
            return
        mode = self.modes.modes[name]
        hw.situation = f"control mode {name}"
        reason = "robot time went back" if went_back else hw.situation
        if name == ControlMode.NONE and self.interface.behavior:
            reason = f"{reason}, the Motion System is in {self.interface.behavior}"
        self.joints.enter(name, mode.joint_controllers, hw, reason, anew=anew)
        self.robots.enter(name, mode.robot_controllers, hw, reason, anew=anew)

    def close(self) -> None:
        """Ask the Motion System for nothing more. The node is closed by its owner."""
        self.interface.close()
