"""Where the robot is: attitude from the IMU, position and velocity from the loaded legs and the accelerometer.

Never the simulator's truth. Three parts:

- ``Attitude``: gyroscope integrated, drawn slowly towards the IMU's own attitude (a complementary filter, Mahony et al.
  2008); its heading relative to odom is held by the loaded feet, for an IMU's heading drifts.
- leg odometry: a loaded foot stands still, so the pelvis moves as the leg's kinematics says (weights by vertical force;
  at its centre of pressure, which stands still even when the foot rolls over an edge).
- ``OdometryFilter``: a steady-state Kalman filter of position, velocity and the accelerometer's bias, the same on each
  axis (Bloesch et al. 2012 in spirit, with constant gains).
"""

from __future__ import annotations

from math import atan2
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_are

from motion_manager.whole_body import rotation
from motion_manager.whole_body.arms import UpperBodyKinematics
from motion_manager.whole_body.dcm import DcmLaw
from motion_manager.whole_body.dynamics import COM, SOLES, Dynamics
from motion_manager.whole_body.rotation import Quaternion
from motion_manager.whole_body.state import FloatArray, RobotState
from valor_common.messages import Proprioceptor
from valor_common.model import Model
from valor_common.robot import Estimator, RobotDescription

LONGEST_GAP = 0.02  # between Proprioceptors that the gyroscope's rate is believed for [s]

Vector = tuple[float, float, float]


class Attitude:
    """Orientation of the pelvis in odom.

    Attributes:
        orientation: of the pelvis in odom.
    """

    def __init__(self, gain: float, imu_in_pelvis: Quaternion) -> None:
        """Upright.

        Args:
            gain: share of the IMU's attitude taken over each period.
            imu_in_pelvis: how it is mounted.
        """
        self._gain = gain
        self._mounting = rotation.conjugate(imu_in_pelvis)
        self._heading = rotation.IDENTITY  # of odom from the IMU's world
        self.orientation = rotation.IDENTITY

    def reset(self, imu_orientation: Quaternion) -> None:
        """Take the IMU's attitude as it is."""
        self._heading = rotation.IDENTITY
        self.orientation = rotation.multiply(imu_orientation, self._mounting)

    def turn(self, angle: float) -> None:
        """Turn the estimate and the heading about the vertical [rad]."""
        turned = rotation.about_z(angle)
        self._heading = rotation.multiply(turned, self._heading)
        self.orientation = rotation.multiply(turned, self.orientation)

    def turn_heading(self, angle: float) -> None:
        """Turn the heading alone by a small angle [rad]; the estimate follows with the filter."""
        self._heading = rotation.quaternion(rotation.multiply(rotation.small(0.0, 0.0, angle), self._heading))

    def update(self, imu_orientation: Quaternion, angular_velocity: FloatArray, dt: float) -> None:
        """Predict with the angular velocity (3,) in pelvis [rad/s] over ``dt`` [s], correct with the attitude."""
        x, y, z = angular_velocity.tolist()
        predicted = rotation.multiply(self.orientation, rotation.small(x * dt, y * dt, z * dt))
        measured = rotation.multiply(self._heading, rotation.multiply(imu_orientation, self._mounting))
        w, ex, ey, ez = rotation.multiply(rotation.conjugate(predicted), measured)
        gain = 2.0 * self._gain if w >= 0.0 else -2.0 * self._gain
        corrected = rotation.multiply(predicted, rotation.small(gain * ex, gain * ey, gain * ez))
        self.orientation = rotation.quaternion(corrected)


class OdometryFilter:
    """Position, velocity and accelerometer bias on three axes, with constant gains.

        p⁺ = p + v·dt + ½(a − b)·dt²,   v⁺ = v + (a − b)·dt,   b⁺ = b

    corrected by the legs' position and velocity. The gains are those of the stationary Kalman filter.

    Attributes:
        state: (3, 3) rows position [m], velocity [m/s], bias [m/s²]; columns x, y, z in odom.
    """

    def __init__(self, table: Estimator, dt: float) -> None:
        self._transition = np.array([[1.0, dt, -0.5 * dt * dt], [0.0, 1.0, -dt], [0.0, 0.0, 1.0]])
        self._input = np.array([[0.5 * dt * dt], [dt], [0.0]])
        measured = np.eye(2, 3)
        process = self._input @ self._input.T * table.acceleration_deviation**2
        process[2, 2] = table.bias_walk**2 * dt
        noise = np.diag((table.leg_position_deviation**2, table.leg_velocity_deviation**2))
        covariance = solve_discrete_are(self._transition.T, measured.T, process + 1e-16 * np.eye(3), noise)
        self._gain = covariance @ measured.T @ np.linalg.inv(measured @ covariance @ measured.T + noise)
        self._leak = np.array([[1.0], [np.exp(-dt / table.hang_time_constant)], [1.0]])
        self.state = np.zeros((3, 3))

    def reset(self, position: FloatArray) -> None:
        """Stand still at ``position`` (3,)."""
        self.state[:] = 0.0
        self.state[0] = position

    def predict(self, acceleration: FloatArray) -> None:
        """Go on by one period with the acceleration (3,) in odom [m/s²]."""
        self.state = self._transition @ self.state
        self.state += self._input * acceleration

    def correct(self, measured: FloatArray) -> None:
        """Correct with the legs' position and velocity (2, 3) in odom."""
        self.state += self._gain @ (measured - self.state[:2])

    def hang(self) -> None:
        """No foot is on the ground: let the velocity fade, for nothing corrects it."""
        self.state *= self._leak


class FloatingBaseEstimator:
    """Estimates the floating base from Proprioceptor, and with it all of ``RobotState``.

    Attributes:
        dynamics: at the last state.
    """

    def __init__(self, robot: RobotDescription, model: Model) -> None:
        table = robot.tables.estimator
        dt = robot.control_period
        self.dynamics = Dynamics(model)
        self._dt = dt
        self._places = self.dynamics.joints.places
        site = model.site(robot.tables.imu.site)
        mounting = rotation.quaternion(model.mj.site_quat[site])
        if int(model.mj.site_bodyid[site]) != model.body(robot.tables.base):
            raise ValueError(f"{robot.name}: the IMU's site {robot.tables.imu.site!r} is not on the floating base")
        self._imu_rotation = np.zeros((3, 3))
        rotation.matrix(mounting, self._imu_rotation)
        self._attitude = Attitude(1.0 - float(np.exp(-dt / table.attitude_time_constant)), mounting)
        self._filter = OdometryFilter(table, dt)
        self._smoothing = 1.0 - float(np.exp(-dt * 2.0 * np.pi * table.joint_velocity_bandwidth))
        self._heading_gain = dt / table.heading_time_constant
        self._anchor_gain = dt / table.anchor_time_constant
        weight = self.dynamics.mass * self.dynamics.gravity
        self._contact_on, self._contact_off = table.contact_on * weight, table.contact_off * weight
        upper_body = UpperBodyKinematics(model)
        self._inverse_omega = 1.0 / DcmLaw.natural_frequency(upper_body.nominal_com_height, self.dynamics.gravity)
        self._gravity = np.array((0.0, 0.0, self.dynamics.gravity))
        self._raw_velocity = np.zeros(model.mj.nv)
        self._joint_velocity = np.zeros(len(robot.joints))
        self._anchor = np.zeros((2, 3))  # where each loaded sole stands in odom
        self._anchor_yaw = [0.0, 0.0]
        self._contact = [False, False]
        self._settled = [0, 0]  # when each foot lies flat, robot time [ns]
        self._settling = round(table.settling_time * 1e9)
        self._time = 0
        self._started = False

    def reset(self) -> None:
        """Begin anew with the next Proprioceptor: odom between the feet, at the soles' height, facing as they do."""
        self._started = False

    def update(self, proprioceptor: Proprioceptor) -> RobotState:
        """The estimate at a Proprioceptor, whose arrays have the robot's lengths and are finite."""
        orientation = rotation.quaternion(proprioceptor.imu_orientation)
        angular_velocity = self._imu_rotation @ proprioceptor.imu_angular_velocity
        position, velocity = proprioceptor.joint_position, proprioceptor.joint_velocity
        if not self._started:
            self._start(orientation, angular_velocity, position, velocity)
            self._time = proprioceptor.time
        passed = 1e-9 * (proprioceptor.time - self._time)
        self._time = proprioceptor.time
        self._attitude.update(orientation, angular_velocity, min(max(passed, 0.0), LONGEST_GAP))
        self._joint_velocity = self._joint_velocity + (velocity - self._joint_velocity) * self._smoothing
        dynamics, places = self.dynamics, self._places
        dynamics.update(self._attitude.orientation, angular_velocity, position[places], self._joint_velocity[places])

        feet = self._foot_forces(proprioceptor)
        self._filter.predict(
            dynamics.rotation @ (self._imu_rotation @ proprioceptor.imu_linear_acceleration) - self._gravity
        )
        self._correct_by_legs(feet, angular_velocity, velocity)
        base, base_velocity = self._filter.state[0].copy(), self._filter.state[1].copy()
        com = base + dynamics.com
        com_velocity = base_velocity + dynamics.task_velocity[COM]
        return RobotState(
            time=proprioceptor.time,
            joint_position=position,
            joint_velocity=self._joint_velocity,
            joint_effort=proprioceptor.joint_effort,
            pelvis_position_in_odom=base,
            pelvis_orientation_in_odom=np.array(self._attitude.orientation),
            pelvis_rotation_in_odom=dynamics.rotation.copy(),
            pelvis_linear_velocity_in_odom=base_velocity,
            pelvis_angular_velocity_in_pelvis=angular_velocity,
            com_in_odom=com,
            com_velocity_in_odom=com_velocity,
            dcm_in_odom=com + com_velocity * self._inverse_omega,
            contacts=np.array(self._contact, dtype=np.uint8),
            foot_forces=np.array((feet[0].force, feet[1].force)),
            cop_in_odom=self._cop(base, feet),
            sole_positions_in_odom=dynamics.sole_position + base,
            sole_rotations_in_odom=dynamics.sole_rotation.copy(),
            dynamics=dynamics,
        )

    def _start(
        self, orientation: Quaternion, angular_velocity: FloatArray, position: FloatArray, velocity: FloatArray
    ) -> None:
        """Put odom between the feet; whichever carries weight, both are taken to stand."""
        dynamics, attitude, places = self.dynamics, self._attitude, self._places
        self._joint_velocity = velocity.copy()
        attitude.reset(orientation)
        dynamics.update(attitude.orientation, angular_velocity, position[places], velocity[places])
        attitude.turn(-rotation.mean_yaw(dynamics.sole_rotation[0], dynamics.sole_rotation[1]))
        dynamics.update(attitude.orientation, angular_velocity, position[places], velocity[places])
        self._filter.reset(-dynamics.sole_position.mean(axis=0))
        self._contact = [False, False]
        self._started = True

    def _foot_forces(self, proprioceptor: Proprioceptor) -> list[_Foot]:
        """What each foot feels, as floats: there are too few numbers for NumPy."""
        soles = zip(
            self.dynamics.sole_position.tolist(),
            self.dynamics.sole_rotation.tolist(),
            (proprioceptor.left_foot_wrench.tolist(), proprioceptor.right_foot_wrench.tolist()),
            strict=True,
        )
        feet = []
        for (px, py, _), (row_x, row_y, row_z), (fx, fy, fz, tx, ty, _) in soles:
            vertical = row_z[0] * fx + row_z[1] * fy + row_z[2] * fz
            x, y = (-ty / fz, tx / fz) if fz > self._contact_off else (0.0, 0.0)
            cop = (row_x[0] * x + row_x[1] * y, row_y[0] * x + row_y[1] * y, row_z[0] * x + row_z[1] * y)
            feet.append(_Foot(vertical, cop, (px + cop[0], py + cop[1]), atan2(row_y[0], row_x[0])))
        return feet

    def _correct_by_legs(self, feet: list[_Foot], angular_velocity: FloatArray, velocity: FloatArray) -> None:
        weights = [self._weight(i, foot) for i, foot in enumerate(feet)]
        settling = [weight > 0.0 and self._time < at for weight, at in zip(weights, self._settled, strict=True)]
        if any(settling) and not all(settling):
            # A foot that comes down heel first says nothing about height until it lies flat: the other one does.
            for i, still in enumerate(settling):
                if still and weights[1 - i] > 0.0:
                    weights[i] = 0.0
                    self._anchor[i] = self._filter.state[0] + self.dynamics.sole_position[i]
                    self._anchor_yaw[i] = feet[i].yaw
        total = weights[0] + weights[1]
        if total <= 0.0:
            self._filter.hang()
            return
        left, right = weights[0] / total, weights[1] / total
        raw, dynamics = self._raw_velocity, self.dynamics
        raw[3:6] = angular_velocity
        raw[6:] = velocity[self._places]
        v = (dynamics.jacobian[SOLES] @ raw).tolist()
        lx, ly, lz = _velocity_at(v[0:3], v[3:6], feet[0].cop)
        rx, ry, rz = _velocity_at(v[6:9], v[9:12], feet[1].cop)
        standing = self._anchor - dynamics.sole_position  # the pelvis, as each foot says
        measured = np.array(
            (
                (0.0, 0.0, 0.0),
                (-left * lx - right * rx, -left * ly - right * ry, -left * lz - right * rz),
            )
        )
        np.dot((left, right), standing, measured[0])
        self._filter.correct(measured)
        standing -= self._filter.state[0]
        standing *= self._anchor_gain
        self._anchor -= standing  # slip wears off
        if self._contact[0] and self._contact[1]:
            turned = left * (self._anchor_yaw[0] - feet[0].yaw) + right * (self._anchor_yaw[1] - feet[1].yaw)
            self._attitude.turn_heading(self._heading_gain * turned)

    def _weight(self, i: int, foot: _Foot) -> float:
        """How much foot ``i`` says about the pelvis [N]; 0 in the air. Its anchor is set when it touches down."""
        if foot.force < self._contact_off:
            self._contact[i] = False
            return 0.0
        if not self._contact[i]:
            if foot.force < self._contact_on:
                return 0.0
            self._contact[i] = True
            self._settled[i] = self._time + self._settling
            self._anchor[i] = self._filter.state[0] + self.dynamics.sole_position[i]
            self._anchor_yaw[i] = foot.yaw
        return foot.force - self._contact_off

    def _cop(self, base: FloatArray, feet: list[_Foot]) -> FloatArray:
        """(2,) centre of pressure of both feet in odom [m]; NaN without contact."""
        left, right = (foot.force if contact else 0.0 for foot, contact in zip(feet, self._contact, strict=True))
        total = left + right
        if total <= 0.0:
            return np.full(2, np.nan)
        left, right = left / total, right / total
        (lx, ly), (rx, ry) = feet[0].place, feet[1].place
        return np.array((base[0] + left * lx + right * rx, base[1] + left * ly + right * ry))


class _Foot(NamedTuple):
    """A foot in one period, in odom's axes."""

    force: float  # vertical [N]
    cop: Vector  # centre of pressure from the sole's origin [m]
    place: tuple[float, float]  # of the centre of pressure, from the pelvis [m]
    yaw: float  # of the sole [rad]


def _velocity_at(linear: list[float], angular: list[float], place: Vector) -> Vector:
    """Of a point of a body: v + ω×r."""
    (vx, vy, vz), (wx, wy, wz), (x, y, z) = linear, angular, place
    return vx + wy * z - wz * y, vy + wz * x - wx * z, vz + wx * y - wy * x
