"""Floating-base estimator: attitude from the IMU, position and velocity from standing feet and accelerometer.

- ``Attitude``: gyroscope and the IMU's attitude; its level comes from gravity, its heading from the standing feet.
- ``FootContact``: probability that each foot stands.
- ``Odometry``: a Kalman filter of position, velocity and footholds.
- ``Fusion``: leg kinematics, and the data exchanged between the parts.

A period is two kernels (``fusion``), with the model's kinematics in between.
"""

from itertools import pairwise
from operator import itemgetter

import numpy as np
import numpy.typing as npt
from msgspec.structs import replace

from valor.common import rotation
from valor.common.kernel import Kernel
from valor.common.messages import Proprioceptor
from valor.control.estimation.filters import FEET, POSITION, Attitude, FootSense
from valor.control.estimation.fusion import SENT, Fusion, Memory
from valor.control.kinematics import Kinematics, UpperBodyKinematics, natural_frequency
from valor.control.state import RobotState
from valor.control.tuning_tables import Tuning
from valor.robot.description import RobotDescription
from valor.robot.model import Model

QUASI_STATIC = 0.3  # Deviation of the acceleration that no accelerometer measures, fraction of gravity
LONGEST_GAP = 0.02  # Longest period over which the IMU's rates are integrated [s]
_CONTACTS: tuple[npt.NDArray[np.uint8], ...] = tuple(
    np.array(pair, dtype=np.uint8) for pair in ((0, 0), (1, 0), (0, 1), (1, 1))
)
for _pair in _CONTACTS:
    _pair.flags.writeable = False


class FloatingBaseEstimator:
    """Estimates the floating base and all of ``RobotState`` from Proprioceptor."""

    def __init__(self, robot: RobotDescription, model: Model) -> None:
        table = robot.read(Tuning).estimator
        self.kinematics = kinematics = Kinematics(model)  # model at the last state
        if not robot.tables.imu.accelerometer:  # the acceleration is assumed to be zero, and shows no tilt
            acceleration = QUASI_STATIC * kinematics.gravity
            table = replace(table, acceleration_deviation=acceleration, bias_deviation=0.0, bias_walk=0.0)
        self._table = table
        self._joints = len(robot.joints)
        site = model.site(robot.tables.imu.site)
        self._mounting = rotation.quaternion(model.mj.site_quat[site])
        if int(model.mj.site_bodyid[site]) != model.body(robot.tables.base):
            raise ValueError(f"{robot.name}: the IMU's site {robot.tables.imu.site!r} is not on the floating base")
        weight = kinematics.mass * kinematics.gravity
        feet, on, off = robot.tables.feet, table.contact_on * weight, table.contact_off * weight
        senses = [
            FootSense(foot, on, off, table.settling_time, table.surprise_gate) for foot in (feet.left, feet.right)
        ]
        omega = natural_frequency(UpperBodyKinematics(model).nominal_com_height, kinematics.gravity)
        fusion = Fusion(table, kinematics, senses, self._mounting, joints=len(robot.joints), omega=omega)
        self._before, self._after = Memory.zeros(self._joints), Memory.zeros(self._joints)
        self._measured = np.zeros(22 + 2 * self._joints)
        self._dt = np.zeros(1)
        self._sent = np.zeros(sum(int(np.prod(shape)) for shape in SENT.values()))
        self._touching = np.zeros(2)
        ends = np.cumsum([0, *(np.prod(shape) for shape in SENT.values())]).tolist()
        self._fields = itemgetter(*(slice(*pair) for pair in pairwise(ends)))
        self._feel_motion = Kernel(
            "imu",
            fusion.by_imu,
            (*self._after, self._measured, self._dt),
            (*self._before, kinematics.configuration, kinematics.rates),
        )
        self._feel_ground = Kernel(
            "feet",
            fusion.by_feet,
            (
                *self._before,
                self._measured,
                self._dt,
                kinematics.rotation,
                kinematics.com,
                kinematics.com_velocity,
                kinematics.sole_position,
                kinematics.sole_rotation,
                kinematics.sole_jacobian,
            ),
            (*self._after, self._sent, self._touching),
        )
        self._time = 0
        self._started = False

    def reset(self) -> None:
        """Restart with the next Proprioceptor: odom between the soles, at their height, with their heading."""
        self._started = False

    def update(self, proprioceptor: Proprioceptor) -> RobotState:
        """Return the estimate for a Proprioceptor, whose arrays must have the robot's lengths and be finite."""
        np.concatenate(
            (
                proprioceptor.imu_orientation,
                proprioceptor.imu_angular_velocity,
                proprioceptor.imu_linear_acceleration,
                proprioceptor.left_foot_wrench,
                proprioceptor.right_foot_wrench,
                proprioceptor.joint_position,
                proprioceptor.joint_velocity,
            ),
            out=self._measured,
        )
        if not self._started:
            self._start(proprioceptor)
        passed = 1e-9 * (proprioceptor.time - self._time)
        self._time = proprioceptor.time
        self._dt[0] = min(max(passed, 0.0), LONGEST_GAP)
        self._feel_motion()
        self.kinematics.evaluate()
        self._feel_ground()
        # By position: twenty keyword arguments take longer than computing the fields.
        turned, soles, sole_rotations, *vectors = self._fields(self._sent.copy())
        left, right = self._touching.tolist()
        return RobotState(
            proprioceptor.time,
            proprioceptor.joint_position,
            self._after.joint_velocity.copy(),
            proprioceptor.joint_effort,
            self.kinematics,
            _CONTACTS[int(left + 2.0 * right)],
            turned.reshape(3, 3),
            soles.reshape(2, 3),
            sole_rotations.reshape(2, 3, 3),
            *vectors,
        )

    def _start(self, proprioceptor: Proprioceptor) -> None:
        """Set odom between the feet, which are assumed to stand both."""
        kinematics, after, table = self.kinematics, self._after, self._table
        places = kinematics.joints.places
        position, velocity = proprioceptor.joint_position[places], proprioceptor.joint_velocity[places]
        mounted = np.zeros((3, 3))
        rotation.matrix(self._mounting, mounted)
        rate = mounted @ proprioceptor.imu_angular_velocity
        imu = rotation.quaternion(proprioceptor.imu_orientation)
        orientation = rotation.multiply(imu, rotation.conjugate(self._mounting))
        kinematics.update(orientation, rate, position, velocity)
        turn = rotation.about_z(-rotation.mean_yaw(kinematics.sole_rotation[0], kinematics.sole_rotation[1]))
        orientation = rotation.multiply(turn, orientation)
        kinematics.update(orientation, rate, position, velocity)
        for array in after:
            array[:] = 0.0
        after.attitude[:] = Attitude(orientation, heading=turn, rate=tuple(rate.tolist())).numbers
        after.state[POSITION] = -kinematics.sole_position.mean(axis=0)
        after.state[FEET:] = after.state[POSITION] + kinematics.sole_position
        leg = table.leg_position_deviation**2
        variances = (0.0, table.start_velocity_deviation**2, table.bias_deviation**2, leg, leg)
        np.fill_diagonal(after.covariance, variances)
        after.acceleration[:] = kinematics.rotation @ mounted @ proprioceptor.imu_linear_acceleration
        after.acceleration[2] -= kinematics.gravity
        after.joint_velocity[:] = proprioceptor.joint_velocity
        self._time = proprioceptor.time
        self._started = True
