"""A controller of ``valor.control`` that runs on the state that the Motion System publishes."""

from math import exp, pi

import numpy as np

from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.common.messages import MotionState, Proprioceptor
from valor.control.controller import Controller, JointCommand, JointTargets, Request
from valor.control.kinematics import Kinematics
from valor.control.state import RobotState
from valor.control.tuning_tables import Tuning
from valor.policies.factories import controller_factory
from valor.robot.commanded_limits import Indices
from valor.robot.description import RobotDescription
from valor.robot.model import controller_model
from valor.robot.motion_tables import WHOLE_BODY
from valor.whole_body.controller import WholeBodyController


class Balancing:
    """A controller with its inputs; it holds the waist where it was, and other joints are where their targets are."""

    def __init__(self, robot: RobotDescription, name: str, joints: Indices) -> None:
        """``joints``: (k,) indices of those that it commands. Raises ConfigurationError as ``BalanceController``."""
        self._estimate = PublishedEstimate(robot)
        self._controller: Controller
        if name == WHOLE_BODY:
            self._controller = controller = WholeBodyController(robot, self._estimate.kinematics)
            controller.may_recover = False  # ``remote`` keeps both feet where they are
        else:
            self._controller = controller_factory(robot, name)(robot, self._estimate.kinematics)
        if others := [robot.joints[joint] for joint in joints if not self._controller.joints[joint]]:
            text = f"controller {name!r} does not command {', '.join(others)}; expected all joints of legs and waist"
            raise ConfigurationError(text)
        self._joints, self._still = joints, np.zeros(len(robot.joints))
        self._gains = robot.servo_stiffness, robot.servo_damping
        self._posture: FloatArray = robot.nominal_posture  # targets of ``joints`` [rad]

    def update(self, measured: Proprioceptor, motion: MotionState, dt: float, *, fresh: bool) -> JointCommand | None:
        """Command ``dt`` after the last one [s]; ``fresh``: start from this state."""
        state = self._estimate.update(measured, motion, dt)
        if fresh:
            self._controller.begin(state, None)
            self._posture = motion.joint_setpoint
        targets = motion.joint_setpoint.copy()
        targets[self._joints] = self._posture[self._joints]  # theirs would be this controller's own
        request = Request(JointTargets(targets, self._still, self._still, *self._gains))
        return self._controller.update(state, request, dt)


class PublishedEstimate:
    """The robot's state: MotionState has the estimate, the Proprioceptor of the same time joints and wrenches."""

    def __init__(self, robot: RobotDescription) -> None:
        self.kinematics = Kinematics(controller_model(robot))
        self._bandwidth = 2.0 * pi * robot.read(Tuning).estimator.joint_velocity_bandwidth  # [1/s]
        self._velocity: FloatArray = np.zeros(len(robot.joints))  # filtered as by the estimator [rad/s]

    def update(self, measured: Proprioceptor, motion: MotionState, dt: float) -> RobotState:
        """State ``dt`` after the last one [s]."""
        model, places = self.kinematics, self.kinematics.joints.places
        smoothing = 1.0 - exp(-dt * self._bandwidth)
        self._velocity = self._velocity + (measured.joint_velocity - self._velocity) * smoothing
        model.update(
            rotation.quaternion(motion.pelvis_orientation_in_odom),
            motion.pelvis_angular_velocity_in_pelvis,
            measured.joint_position[places],
            self._velocity[places],
        )
        soles = model.sole_rotation.copy()
        wrenches = np.stack((measured.left_foot_wrench, measured.right_foot_wrench))
        return RobotState(
            time=measured.time,
            joint_position=measured.joint_position,
            joint_velocity=self._velocity,
            joint_effort=measured.joint_effort,
            kinematics=model,
            contacts=motion.contacts,
            pelvis_rotation_in_odom=model.rotation.copy(),
            sole_positions_in_odom=motion.pelvis_position_in_odom + model.sole_position,
            sole_rotations_in_odom=soles,
            pelvis_position_in_odom=motion.pelvis_position_in_odom,
            pelvis_orientation_in_odom=motion.pelvis_orientation_in_odom,
            pelvis_linear_velocity_in_odom=motion.pelvis_linear_velocity_in_odom,
            pelvis_angular_velocity_in_pelvis=motion.pelvis_angular_velocity_in_pelvis,
            com_in_odom=motion.com_in_odom,
            com_velocity_in_odom=motion.pelvis_linear_velocity_in_odom + model.com_velocity,
            dcm_in_odom=motion.dcm_in_odom,
            contact_probability=motion.contact_probability,
            foot_forces=np.einsum("ij,ij->i", soles[:, 2], wrenches[:, :3]),
            cop_in_odom=motion.cop_in_odom,
            pelvis_position_variance=motion.pelvis_position_variance,
            pelvis_orientation_variance=motion.pelvis_orientation_variance,
            pelvis_linear_velocity_variance=motion.pelvis_linear_velocity_variance,
            pelvis_in_support=motion.pelvis_in_support,
        )
