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


class Attitude:
    """Orientation of the pelvis in odom.

    Attributes:
        orientation: of the pelvis in odom.
    """

    def __init__(self, gain: float, imu_in_pelvis: Quaternion) -> None:
        """Args: gain: share of the IMU's attitude taken over each period. imu_in_pelvis: how it is mounted."""
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
        self._inverse_omega = 1.0 / DcmLaw.natural_frequency(
            upper_body.nominal_com_height, self.dynamics.gravity
        )
        self._gravity = np.array((0.0, 0.0, self.dynamics.gravity))
        self._raw_velocity = np.zeros(model.mj.nv)
        self._joint_velocity = np.zeros(len(robot.joints))
        self._anchor = np.zeros((2, 3))  # where each loaded sole stands in odom
        self._anchor_yaw = [0.0, 0.0]
        self._contact = [False, False]
        self._started = False

    def reset(self) -> None:
        """Begin anew with the next Proprioceptor: odom's origin between the feet, at the soles' height, facing as they do."""
        self._started = False

    def update(self, proprioceptor: Proprioceptor) -> RobotState:
        """The estimate at a Proprioceptor, whose arrays have the robot's lengths and are finite."""
        orientation = rotation.quaternion(proprioceptor.imu_orientation)
        angular_velocity = self._imu_rotation @ proprioceptor.imu_angular_velocity
        position, velocity = proprioceptor.joint_position, proprioceptor.joint_velocity
        if not self._started:
            self._start(orientation, angular_velocity, position, velocity)
        self._attitude.update(orientation, angular_velocity, self._dt)
        self._joint_velocity = self._joint_velocity + (velocity - self._joint_velocity) * self._smoothing
        dynamics, places = self.dynamics, self._places
        dynamics.update(self._attitude.orientation, angular_velocity, position[places], self._joint_velocity[places])

        forces, cops = self._foot_forces(proprioceptor)
        self._filter.predict(
            dynamics.rotation @ (self._imu_rotation @ proprioceptor.imu_linear_acceleration) - self._gravity
        )
        self._correct_by_legs(forces, cops, angular_velocity, velocity)
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
            foot_forces=np.array(forces),
            cop_in_odom=self._cop(base, forces, cops),
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

    def _foot_forces(self, proprioceptor: Proprioceptor) -> tuple[list[float], list[tuple[float, float]]]:
        """Vertical force of each foot [N], and its centre of pressure in the sole's axes [m]."""
        forces, cops = [], []
        for rotation_in_odom, wrench in zip(
            self.dynamics.sole_rotation, (proprioceptor.left_foot_wrench, proprioceptor.right_foot_wrench), strict=True
        ):
            forces.append(float(rotation_in_odom[2] @ wrench[:3]))
            _, _, fz, tx, ty, _ = wrench.tolist()
            cops.append((-ty / fz, tx / fz) if fz > self._contact_off else (0.0, 0.0))
        return forces, cops

    def _correct_by_legs(
        self, forces: list[float], cops: list[tuple[float, float]], angular_velocity: FloatArray, velocity: FloatArray
    ) -> None:
        dynamics, soles = self.dynamics, self.dynamics.sole_position
        predicted = self._filter.state[0]
        weights = [0.0, 0.0]
        for i in range(2):
            if forces[i] < self._contact_off:
                self._contact[i] = False
                continue
            if not self._contact[i]:
                if forces[i] < self._contact_on:
                    continue
                self._contact[i] = True
                self._anchor[i] = predicted + soles[i]
                self._anchor_yaw[i] = rotation.yaw(dynamics.sole_rotation[i])
            weights[i] = forces[i] - self._contact_off
        total = weights[0] + weights[1]
        if total <= 0.0:
            self._filter.hang()
            return
        left, right = weights[0] / total, weights[1] / total
        self._raw_velocity[3:6] = angular_velocity
        self._raw_velocity[6:] = velocity[self._places]
        sole_velocity = (dynamics.jacobian[SOLES] @ self._raw_velocity).reshape(2, 6)
        standing = self._anchor - soles
        measured = np.empty((2, 3))
        measured[0] = left * standing[0] + right * standing[1]
        measured[1] = -left * self._velocity_at_cop(0, sole_velocity[0], cops[0])
        measured[1] -= right * self._velocity_at_cop(1, sole_velocity[1], cops[1])
        self._filter.correct(measured)
        self._anchor += (self._filter.state[0] - standing) * self._anchor_gain  # slip wears off
        if self._contact[0] and self._contact[1]:
            turned = [self._anchor_yaw[i] - rotation.yaw(dynamics.sole_rotation[i]) for i in range(2)]
            self._attitude.turn_heading(self._heading_gain * (left * turned[0] + right * turned[1]))

    def _velocity_at_cop(self, foot: int, sole_velocity: FloatArray, cop: tuple[float, float]) -> FloatArray:
        """(3,) of the point of the foot at its centre of pressure, relative to the pelvis' velocity [m/s]."""
        frame = self.dynamics.sole_rotation[foot]
        vx, vy, vz, wx, wy, wz = sole_velocity.tolist()
        x, y, z = (frame[:, 0] * cop[0] + frame[:, 1] * cop[1]).tolist()
        return np.array((vx + wy * z - wz * y, vy + wz * x - wx * z, vz + wx * y - wy * x))

    def _cop(self, base: FloatArray, forces: list[float], cops: list[tuple[float, float]]) -> FloatArray:
        """(2,) centre of pressure of both feet in odom [m]; NaN without contact."""
        cop, total = np.zeros(2), 0.0
        for i in range(2):
            if self._contact[i]:
                frame = self.dynamics.sole_rotation[i]
                place = self.dynamics.sole_position[i] + frame[:, 0] * cops[i][0] + frame[:, 1] * cops[i][1]
                cop += forces[i] * (base[:2] + place[:2])
                total += forces[i]
        return cop / total if total > 0.0 else np.full(2, np.nan)
