"""Where the robot is: attitude from the IMU, position and velocity from the standing feet and the accelerometer.

Never the simulator's truth. Four parts:

- ``Attitude``: gyroscope and the IMU's own attitude; its level comes from gravity, its heading from the standing feet.
- ``FootContact``: how probably each foot stands.
- ``OdometryFilter``: a Kalman filter of position, velocity and where the feet stand.
- this: leg kinematics, and what the parts tell each other.

A standing foot is still at its centre of pressure, even when it rolls over an edge or settles on a stone: so the sole's
origin moves as the sole turns about that point. What the accelerometer seems to measure too much horizontally is
gravity, seen from an attitude that is not level: δθ = (b_y, −b_x)/g. It goes to the attitude at once, so that odometry
does not climb: 2 mrad of tilt are 2 mm a metre.
"""

from __future__ import annotations

from math import exp

import numpy as np

from motion_manager.whole_body import rotation
from motion_manager.whole_body.arms import UpperBodyKinematics
from motion_manager.whole_body.attitude import Attitude, Vector
from motion_manager.whole_body.dcm import DcmLaw
from motion_manager.whole_body.dynamics import COM, SOLES, Dynamics
from motion_manager.whole_body.foot_contact import FootContact
from motion_manager.whole_body.odometry import BIAS, FEET, MEASURES, NOTHING, POSITION, VELOCITY, OdometryFilter
from motion_manager.whole_body.rotation import Quaternion
from motion_manager.whole_body.state import FloatArray, RobotState
from valor_common.messages import Proprioceptor
from valor_common.model import Model
from valor_common.robot import RobotDescription

LONGEST_GAP = 0.02  # between Proprioceptors that the IMU's rates are believed for [s]


class FloatingBaseEstimator:
    """Estimates the floating base from Proprioceptor, and with it all of ``RobotState``.

    Attributes:
        dynamics: at the last state.
    """

    def __init__(self, robot: RobotDescription, model: Model) -> None:
        self._table = table = robot.tables.estimator
        self.dynamics = Dynamics(model)
        self._places = self.dynamics.joints.places
        site = model.site(robot.tables.imu.site)
        mounting = rotation.quaternion(model.mj.site_quat[site])
        if int(model.mj.site_bodyid[site]) != model.body(robot.tables.base):
            raise ValueError(f"{robot.name}: the IMU's site {robot.tables.imu.site!r} is not on the floating base")
        self._imu_rotation = np.zeros((3, 3))
        rotation.matrix(mounting, self._imu_rotation)
        self._attitude = Attitude(table.attitude_time_constant, mounting)
        self._filter = OdometryFilter(table)
        weight = self.dynamics.mass * self.dynamics.gravity
        feet, on, off = robot.tables.feet, table.contact_on * weight, table.contact_off * weight
        self._feet = [
            FootContact(foot, on, off, table.settling_time, table.surprise_gate) for foot in (feet.left, feet.right)
        ]
        upper_body = UpperBodyKinematics(model)
        self._inverse_omega = 1.0 / DcmLaw.natural_frequency(upper_body.nominal_com_height, self.dynamics.gravity)
        self._gravity = np.array((0.0, 0.0, self.dynamics.gravity))
        self._raw_velocity = np.zeros(model.mj.nv)
        self._joint_velocity = np.zeros(len(robot.joints))
        self._measured = np.zeros((MEASURES, 3))
        self._variances = np.zeros(MEASURES)
        self._anchor_yaw = [0.0, 0.0]  # how each standing sole is turned in odom
        self._heading_variance = 0.0
        self._dt = self._smoothing = 0.0
        self._time = 0
        self._started = False

    def reset(self) -> None:
        """Begin anew with the next Proprioceptor: odom between the feet, at the soles' height, facing as they do."""
        self._started = False

    def update(self, proprioceptor: Proprioceptor) -> RobotState:
        """The estimate at a Proprioceptor, whose arrays have the robot's lengths and are finite."""
        dynamics, odometry = self.dynamics, self._filter
        orientation = rotation.quaternion(proprioceptor.imu_orientation)
        angular_velocity = self._imu_rotation @ proprioceptor.imu_angular_velocity
        specific_force = self._imu_rotation @ proprioceptor.imu_linear_acceleration
        position, velocity = proprioceptor.joint_position, proprioceptor.joint_velocity
        if not self._started:
            self._start(proprioceptor, orientation, angular_velocity, specific_force)
        passed = 1e-9 * (proprioceptor.time - self._time)
        self._time = proprioceptor.time
        dt = min(max(passed, 0.0), LONGEST_GAP)
        if dt != self._dt:
            self._dt = dt
            self._smoothing = 1.0 - exp(-dt * 2.0 * np.pi * self._table.joint_velocity_bandwidth)
        rate: Vector = tuple(angular_velocity.tolist())
        self._attitude.update(orientation, rate, dt)
        self._joint_velocity = self._joint_velocity + (velocity - self._joint_velocity) * self._smoothing
        places = self._places
        dynamics.update(self._attitude.orientation, angular_velocity, position[places], self._joint_velocity[places])
        self._touch(proprioceptor, dt)
        odometry.predict(dynamics.rotation @ specific_force - self._gravity, dt, self._wander())
        self._correct_by_feet(angular_velocity, velocity, dt)
        return self._state(proprioceptor, angular_velocity)

    def _state(self, proprioceptor: Proprioceptor, angular_velocity: FloatArray) -> RobotState:
        dynamics, odometry, feet = self.dynamics, self._filter, self._feet
        base, base_velocity = odometry.state[POSITION].copy(), odometry.state[VELOCITY].copy()
        com = base + dynamics.com
        com_velocity = base_velocity + dynamics.task_velocity[COM]
        return RobotState(
            time=proprioceptor.time,
            joint_position=proprioceptor.joint_position,
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
            contacts=np.array((feet[0].touching, feet[1].touching), dtype=np.uint8),
            foot_forces=np.array((feet[0].force, feet[1].force)),
            contact_probability=np.array((feet[0].probability, feet[1].probability)),
            cop_in_odom=self._cop(base),
            sole_positions_in_odom=dynamics.sole_position + base,
            sole_rotations_in_odom=dynamics.sole_rotation.copy(),
            pelvis_position_variance=np.full(3, odometry.covariance[POSITION, POSITION]),
            pelvis_orientation_variance=self._orientation_variance(),
            pelvis_linear_velocity_variance=np.full(3, odometry.covariance[VELOCITY, VELOCITY]),
            dynamics=dynamics,
        )

    def _orientation_variance(self) -> FloatArray:
        """(3,) about the axes of odom [rad²]: level as uncertain as the accelerometer's error makes it, and heading."""
        noise, g = self._table.attitude_deviation**2, self.dynamics.gravity
        level = float(self._filter.covariance[BIAS, BIAS]) / (g * g) + noise
        return np.array((level, level, self._heading_variance + noise))

    def _start(
        self,
        proprioceptor: Proprioceptor,
        orientation: Quaternion,
        angular_velocity: FloatArray,
        specific_force: FloatArray,
    ) -> None:
        """Put odom between the feet; whichever carries weight, both are taken to stand."""
        dynamics, attitude, places = self.dynamics, self._attitude, self._places
        position, velocity = proprioceptor.joint_position[places], proprioceptor.joint_velocity[places]
        self._joint_velocity = proprioceptor.joint_velocity.copy()
        attitude.reset(orientation, tuple(angular_velocity.tolist()))
        dynamics.update(attitude.orientation, angular_velocity, position, velocity)
        attitude.turn(-rotation.mean_yaw(dynamics.sole_rotation[0], dynamics.sole_rotation[1]))
        dynamics.update(attitude.orientation, angular_velocity, position, velocity)
        self._filter.reset(
            -dynamics.sole_position.mean(axis=0),
            dynamics.sole_position,
            dynamics.rotation @ specific_force - self._gravity,
        )
        for foot in self._feet:
            foot.lift()
        self._heading_variance = 0.0
        self._time = proprioceptor.time
        self._started = True

    def _touch(self, proprioceptor: Proprioceptor, dt: float) -> None:
        """What the feet feel, and where those stand that have come down."""
        dynamics, odometry, variance = self.dynamics, self._filter, self._table.foothold_deviation**2
        wrenches = (proprioceptor.left_foot_wrench.tolist(), proprioceptor.right_foot_wrench.tolist())
        rotations = dynamics.sole_rotation.tolist()
        for i, foot in enumerate(self._feet):
            foot.update(rotations[i], wrenches[i], odometry.surprise[i], dt)
            if foot.landed:
                odometry.place(i, dynamics.sole_position[i], variance)
                self._anchor_yaw[i] = foot.yaw
                self._heading_variance += self._table.foothold_heading_deviation**2
            elif foot.touching:
                odometry.state[FEET + i] += foot.rolled
                self._anchor_yaw[i] += (1.0 - foot.probability) * (foot.yaw - self._anchor_yaw[i])

    def _wander(self) -> tuple[float, float]:
        """Variance that each foot's place gains a second: little beside the other, more alone, much slipping [m²/s]."""
        left, right = self._feet
        both = min(left.probability, right.probability)
        creep, slip = self._table.creep**2, self._table.slip**2
        creep += (1.0 - both) * self._table.creep_alone**2
        return creep + (1.0 - left.probability) * slip, creep + (1.0 - right.probability) * slip

    def _correct_by_feet(self, angular_velocity: FloatArray, velocity: FloatArray, dt: float) -> None:
        odometry, dynamics, table = self._filter, self.dynamics, self._table
        left, right = self._feet
        weights = [foot.probability * foot.force for foot in self._feet]
        total = weights[0] + weights[1]
        if total <= 0.0:
            odometry.fade(dt)
            self._heading_variance += table.heading_walk**2 * dt
            return
        share = (weights[0] / total, weights[1] / total)
        raw, measured, variances = self._raw_velocity, self._measured, self._variances
        raw[3:6] = angular_velocity
        raw[6:] = velocity[self._places]
        soles = (dynamics.jacobian[SOLES] @ raw).tolist()
        measured[:2] = dynamics.sole_position
        place, rate = table.leg_position_deviation**2, table.leg_velocity_deviation**2
        for i, foot in enumerate(self._feet):
            measured[2 + i] = _away(soles[6 * i : 6 * i + 3], soles[6 * i + 3 : 6 * i + 6], foot.cop)
            # Of two feet that disagree, the one that carries less is the likelier to slip.
            doubt = 0.5 / (share[i] * foot.probability**2) if foot.touching else NOTHING / place
            variances[i], variances[2 + i] = place * doubt, rate * doubt
        odometry.correct(measured, variances)
        self._level(share)
        if left.touching and right.touching:
            turned = [anchor - foot.yaw for anchor, foot in zip(self._anchor_yaw, self._feet, strict=True)]
            turn = share[0] * turned[0] + share[1] * turned[1]
            self._attitude.turn_heading(dt / table.heading_time_constant * turn)
        else:
            self._heading_variance += table.heading_walk**2 * dt

    def _level(self, share: tuple[float, float]) -> None:
        """Turn the attitude by what the accelerometer measures too much, about the feet."""
        state, dynamics = self._filter.state, self.dynamics
        bx, by, _ = state[BIAS].tolist()
        g = dynamics.gravity
        x, y = by / g, -bx / g
        state[BIAS, :2] = 0.0
        first, second, _ = dynamics.rotation.tolist()
        a, b, c = (x * u + y * v for u, v in zip(first, second, strict=True))
        if not self._attitude.tilt((a, b, c)):
            return
        px, py, pz = (np.array(share) @ dynamics.sole_position).tolist()
        state[POSITION] -= (y * pz, -x * pz, x * py - y * px)

    def _cop(self, base: FloatArray) -> FloatArray:
        """(2,) centre of pressure of both feet in odom [m]; NaN without contact."""
        left, right = (foot.force if foot.touching else 0.0 for foot in self._feet)
        total = left + right
        if total <= 0.0:
            return np.full(2, np.nan)
        left, right = left / total, right / total
        (lx, ly, _), (rx, ry, _) = self._feet[0].cop, self._feet[1].cop
        (ax, ay, _), (bx, by, _) = self.dynamics.sole_position.tolist()
        return np.array(
            (base[0] + left * (ax + lx) + right * (bx + rx), base[1] + left * (ay + ly) + right * (by + ry))
        )


def _away(linear: list[float], angular: list[float], place: Vector) -> Vector:
    """The velocity of a body from its point at ``place``: −(v + ω×r)."""
    (vx, vy, vz), (wx, wy, wz), (x, y, z) = linear, angular, place
    return wz * y - wy * z - vx, wx * z - wz * x - vy, wy * x - wx * y - vz
