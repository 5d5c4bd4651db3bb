"""A robot in Stand Manipulate whose arm is led by the VRC's trajectory controller, in one process."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bifrost import Received
from harness.manipulating_robot import ManipulatingRobot
from valor.common.arrays import FloatArray
from valor.common.messages import JointSetpoints
from valor.motion_manager.handlers.joint_setpoints import JointSetpointsHandler
from valor.robot.description import RobotDescription
from valor.valor_ros_controller.controllers.configuration import TrajectoryControllerConfig
from valor.valor_ros_controller.controllers.joint_trajectory_controller import JointTrajectoryController
from valor.valor_ros_controller.controllers.table import ControllersTable
from valor.valor_ros_controller.controllers.trajectory_goal import TrajectoryGoal, TrajectoryRequest
from valor.valor_ros_controller.trajectory.admission import check_waypoints
from valor.valor_ros_controller.trajectory.waypoints import Point
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface

DECIMATION = 2  # control periods of one cycle of the VRC


class StreamedRobot(ManipulatingRobot):
    """Advance with ``cycle``: one cycle of the VRC and the control periods until the next one.

    Attributes:
        controller: of one limb.
        hw: the interface that it writes to.
    """

    def __init__(self, robot: RobotDescription, profile: str = "hardware", limb: str = "left_arm") -> None:
        super().__init__(robot, profile, seed=0)
        self.hw = ValorEscherHWInterface(robot)
        self._read()
        name = f"{limb}_traj_controller"
        config = ControllersTable.load().of_type(TrajectoryControllerConfig)[name]
        self.controller = JointTrajectoryController(name, config, self.hw, ["stand_manipulate"])
        self.names = self.controller.limits.names
        self._handler = JointSetpointsHandler(self.manager.components)
        self.controller.start(self.hw)
        self.cycle()

    def _read(self) -> None:
        motion = self.manager.components.report(self._sequence, motor_time=0.0, tick_time=0.0)
        self.hw.store_measurement(self.measured)
        self.hw.store_motion(motion)

    def submit(self, points: Sequence[Point], goal: TrajectoryGoal | None = None) -> None:
        """A trajectory as it comes from the topic, or with a client that waits."""
        c = self.controller
        waypoints = check_waypoints(self.names, points, c.limits, at_rest=goal is not None)
        c.submit(TrajectoryRequest(waypoints, 0, c.settings.path, c.settings.goal, 2.0, goal))

    def cycle(self) -> None:
        """One cycle of the VRC, and what the robot does until the next."""
        self._read()
        self.controller.update(self.hw)
        if self.hw.written.size:
            names = [self.hw.names[i] for i in self.hw.written]
            message = JointSetpoints(self.hw.time, names, *self.hw.rectify())
            assert self._handler.handle(Received(message, 0, 1, "test"), self.manager.time)
        for _ in range(DECIMATION):
            self.step()

    @property
    def arm(self) -> FloatArray:
        """(n,) true positions of the limb's joints [rad]."""
        return np.array(self.plant.joint_position[self.controller.joints])
