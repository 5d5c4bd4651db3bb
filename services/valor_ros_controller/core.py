"""The Valor ROS Controller without ROS, put together: from what the Motion System says to its set-points.

Two tables say what there is: ``control_modes.yaml`` and ``controllers.yaml``. Who runs the core waits for a
measurement, then updates; what lies between is his own.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import bifrost
from valor.robot.description import RobotDescription
from valor.valor_ros_controller.behavior_commander import Commander
from valor.valor_ros_controller.control_modes import ControlModeTable
from valor.valor_ros_controller.controllers.configuration import ControllersTable
from valor.valor_ros_controller.controllers.control_mode_controller import ControlModeController
from valor.valor_ros_controller.controllers.footstep_controller import FootstepController
from valor.valor_ros_controller.controllers.joint_trajectory_controller import JointTrajectoryController
from valor.valor_ros_controller.controllers.tracking_controller import TrackingController
from valor.valor_ros_controller.valor_escher_controller import ValorEscherController
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface
from valor.valor_ros_controller.valor_escher_interface import ValorEscherInterface


class Core:
    """All parts, each made of those before it.

    Attributes:
        modes: the table of control modes.
        table: of controllers.
        hw: state and commands.
        interface: the Motion System's side.
        mode_controller: the control modes' state machine.
        trajectories: name → trajectory controller, those of joints first.
        tracking: name → controller that only follows the robot.
        footsteps: the footstep controller.
        controller: runs them all.
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
        """
        self.modes, self.table = modes, table = ControlModeTable.load(), ControllersTable.load()
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
        self.controller = ValorEscherController(
            table=modes,
            hw=hw,
            interface=self.interface,
            mode_controller=self.mode_controller,
            joint_controllers=[*(self.trajectories[name] for name in table.joint_controllers), *self.tracking.values()],
            robot_controllers=[self.footsteps, *(self.trajectories[name] for name in table.robot_controllers)],
        )

    def wait(self) -> bool:
        """Wait for the measurement that a cycle is due for, and store it; whether it came."""
        return self.controller.wait()

    def update(self, measured: bool) -> None:
        """Run a cycle; ``measured``: what ``wait`` said."""
        self.controller.update(measured)

    def close(self) -> None:
        """Ask the Motion System for nothing more. The node is closed by its owner."""
        self.interface.close()
