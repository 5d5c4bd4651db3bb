"""``~/controller_state`` of a trajectory or tracking controller."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Time
from control_msgs.msg import JointTrajectoryControllerState
from rclpy.node import Node
from trajectory_msgs.msg import JointTrajectoryPoint

from valor.ros.prepared_message import PreparedPublisher, mark, stamp_mark
from valor.valor_ros_controller.controllers.joint_trajectory_controller import JointTrajectoryController
from valor.valor_ros_controller.controllers.tracking_controller import TrackingController
from valor.valor_ros_controller.schedule import Schedule
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface

Limb = JointTrajectoryController | TrackingController


class ControllerStatePublisher:
    """Publishes while the controller is active and somebody listens.

    Attributes:
        rate: [Hz]; may be changed from any thread.
    """

    def __init__(
        self,
        node: Node,
        topics: Sequence[str],
        controller: Limb,
        stamp: Time,
        rate: float,
    ) -> None:
        """Open the topics.

        Args:
            node: the ROS node.
            topics: names of it.
            controller: is published of; of one that only follows, the Motion System's set-points are the reference.
            stamp: robot time, kept up to date by its owner.
            rate: [Hz].
        """
        self.rate = rate
        self._controller = controller
        self._reference = controller if isinstance(controller, JointTrajectoryController) else None
        self._schedule = Schedule()
        n = len(controller.joints)
        derivatives = 3 if self._reference else 1  # position, velocity, acceleration of the reference
        counts = (derivatives, 2, min(derivatives, 2), derivatives)  # of reference, feedback, error, output
        points, begin = [], 0
        for count in counts:
            fields = [[mark(begin + n * i + j) for j in range(n)] for i in range(count)]
            keys = ("positions", "velocities", "accelerations")
            points.append(JointTrajectoryPoint(**dict(zip(keys, fields, strict=False))))
            begin += n * count
        state = JointTrajectoryControllerState(speed_scaling_factor=1.0, joint_names=list(controller.limits.names))
        state.header.stamp = stamp_mark()
        state.reference, state.feedback, state.error, state.output = points
        self._publisher = PreparedPublisher(node, topics, state, begin, stamp=stamp, queue=1)
        self._rows = np.split(self._publisher.values.reshape(-1, n), np.cumsum(counts)[:-1])

    def publish(self, hw: ValorEscherHWInterface) -> None:
        """Publish if it is due."""
        controller = self._controller
        if not controller.active or not self._schedule.due(hw.time, round(1e9 / self.rate)):
            return
        if not self._publisher.heard:
            return
        reference, feedback, error, output = self._rows
        if own := self._reference:
            reference[0], reference[1], reference[2] = own.position, own.velocity, own.acceleration
        else:
            reference[0] = hw.commanded[controller.joints]
        feedback[0], feedback[1] = hw.position[controller.joints], hw.velocity[controller.joints]
        np.subtract(reference[: len(error)], feedback[: len(error)], out=error)
        output[:] = reference
        self._publisher.publish()
