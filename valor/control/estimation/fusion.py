"""Sensor fusion of the estimator's parts, as the expressions of two kernels.

``by_imu`` turns the memory after the last period into the one before the feet are evaluated; ``by_feet`` turns that
into the memory after this period. The model's kinematics are evaluated in between.

A standing foot is at rest at its centre of pressure, even when it rolls over an edge: the sole's origin moves as the
sole rotates about that point. A horizontal accelerometer bias b is gravity, seen from a tilted attitude:
δθ = (b_y, −b_x)/g. It corrects the attitude at once, so that odometry does not climb: 2 mrad of tilt are 2 mm/m.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from valor.common import rotation
from valor.common.kernel import Expression, parts, pieces, roll_pitch_yaw
from valor.common.rotation import Quaternion
from valor.control.estimation.filters import (
    ATTITUDE_SIZE,
    BIAS,
    FEET,
    NOTHING,
    PAST_SIZE,
    POSITION,
    SIZE,
    VELOCITY,
    Attitude,
    FootContact,
    FootSense,
    Odometry,
    Past,
    chosen,
)
from valor.control.kinematics import Kinematics
from valor.control.tuning_tables import Estimator

SENT: dict[str, tuple[int, ...]] = {
    "pelvis_rotation_in_odom": (3, 3),
    "sole_positions_in_odom": (2, 3),
    "sole_rotations_in_odom": (2, 3, 3),
    "pelvis_position_in_odom": (3,),
    "pelvis_orientation_in_odom": (4,),
    "pelvis_linear_velocity_in_odom": (3,),
    "pelvis_angular_velocity_in_pelvis": (3,),
    "com_in_odom": (3,),
    "com_velocity_in_odom": (3,),
    "dcm_in_odom": (3,),
    "contact_probability": (2,),
    "foot_forces": (2,),
    "cop_in_odom": (2,),
    "pelvis_position_variance": (3,),
    "pelvis_orientation_variance": (3,),
    "pelvis_linear_velocity_variance": (3,),
    "pelvis_in_support": (6,),
}
"""State output of ``by_feet``: the last fields of RobotState in their order, with shapes."""


class Memory(NamedTuple):
    """State between periods: arrays, or expressions."""

    attitude: Expression  # (15,) of ``Attitude``
    state: Expression  # (5, 3) of ``Odometry``
    covariance: Expression  # (5, 5) of ``Odometry``
    acceleration: Expression  # (3,) of ``Odometry`` [m/s²]
    feet: Expression  # (2, 12) of ``Past``, left and right
    surprise: Expression  # (2,) of each leg's last measurement, see ``Odometry.surprise``
    anchors: Expression  # (2,) yaw of each standing sole in odom [rad]
    heading_variance: Expression  # (1,) [rad²]
    joint_velocity: Expression  # (n,) filtered [rad/s]

    @classmethod
    def zeros(cls, joints: int) -> Memory:
        """Create arrays for a robot with n joints."""
        shapes = ((ATTITUDE_SIZE,), (SIZE, 3), (SIZE, SIZE), (3,), (2, PAST_SIZE), (2,), (2,), (1,), (joints,))
        return cls(*(np.zeros(shape) for shape in shapes))


class Measured(NamedTuple):
    """Inputs from Proprioceptor, as expressions."""

    imu_orientation: Expression  # (4,)
    imu_angular_velocity: Expression  # (3,)
    imu_linear_acceleration: Expression  # (3,)
    left_foot_wrench: Expression  # (6,)
    right_foot_wrench: Expression  # (6,)
    joint_position: Expression  # (n,)
    joint_velocity: Expression  # (n,)

    @classmethod
    def of(cls, numbers: Expression, joints: int) -> Measured:
        """Create from (22 + 2n,) numbers, field by field."""
        return cls(*pieces(numbers, (4, 3, 3, 6, 6, joints, joints)))


class Fusion:
    """Expressions of a robot's estimator."""

    def __init__(
        self,
        table: Estimator,
        kinematics: Kinematics,
        feet: Sequence[FootSense],
        mounting: Quaternion,
        *,
        joints: int,
        omega: float,
    ) -> None:
        """Create for n joints and ω of the DCM [1/s]; ``mounting`` is the rotation of the IMU in pelvis."""
        self._table, self._kinematics, self._feet, self._mounting = table, kinematics, feet, mounting
        self._joints, self._inverse_omega = joints, 1.0 / omega

    def by_imu(self, *symbols: Expression) -> Sequence[Expression]:
        """Return the memory with attitude and filtered joint velocities, and the model's configuration and rates."""
        memory, (numbers, dt) = Memory(*symbols[:-2]), symbols[-2:]
        measured = Measured.of(numbers, self._joints)
        imu = parts(measured.imu_orientation)
        rate = self._in_pelvis(measured.imu_angular_velocity)
        known = Attitude.of(memory.attitude).updated(
            rotation.unit(imu), parts(rate), dt, self._table.attitude_time_constant, self._mounting
        )
        smoothing = 1.0 - ca.exp(-dt * (2.0 * np.pi * self._table.joint_velocity_bandwidth))
        velocity = memory.joint_velocity + (measured.joint_velocity - memory.joint_velocity) * smoothing
        joints = self._kinematics.joints.indices
        before = memory._replace(attitude=ca.vertcat(*known.numbers), joint_velocity=velocity)
        return (
            *before,
            ca.vertcat(*known.orientation, measured.joint_position[joints]),
            ca.vertcat(rate, velocity[joints]),
        )

    def _in_pelvis(self, vector: Expression) -> Expression:
        """(3,) a vector in the IMU's axes, rotated to pelvis."""
        return ca.DM(rotation.rows(self._mounting)) @ vector

    def by_feet(self, *symbols: Expression) -> Sequence[Expression]:
        """Return the memory with the measurements of feet and legs, the state, and contacts."""
        memory, (numbers, dt, turned, com, com_moving, soles, sole_rotations, jacobian) = (
            Memory(*symbols[:-8]),
            symbols[-8:],
        )
        measured, table, kinematics = Measured.of(numbers, self._joints), self._table, self._kinematics
        known = Attitude.of(memory.attitude)
        rotations = ca.vertsplit(sole_rotations, 3)
        places = [place.T for place in ca.vertsplit(soles)]
        feet, odometry, anchors, heading_variance = self._felt(memory, measured, rotations, places, dt)
        left, right = feet

        force = turned @ self._in_pelvis(measured.imu_linear_acceleration)
        acceleration = force - ca.vertcat(0.0, 0.0, kinematics.gravity)
        odometry = odometry.predicted(acceleration, dt, self._wander(left, right), table)

        weights = [foot.probability * foot.force for foot in feet]
        total = weights[0] + weights[1]
        standing, both = total > 0.0, ca.logic_and(left.touching, right.touching)
        shares = [ca.if_else(standing, weight / total, 0.0) for weight in weights]
        rates = ca.vertcat(
            self._in_pelvis(measured.imu_angular_velocity), measured.joint_velocity[kinematics.joints.indices]
        )
        legs, variances = self._by_legs(feet, shares, places, jacobian, rates)
        surprise = [
            ca.if_else(standing, now, before)
            for now, before in zip(odometry.surprise(legs, variances), parts(memory.surprise), strict=True)
        ]
        corrected, faded = odometry.corrected(legs, variances), odometry.faded(dt, table.hang_time_constant)
        middle = shares[0] * places[0] + shares[1] * places[1]
        corrected, levelled = self._levelled(known, corrected, turned, middle)
        odometry = Odometry(*(ca.if_else(standing, one, two) for one, two in zip(corrected, faded, strict=True)))
        known = chosen(standing, levelled, known)
        turn = sum(share * (anchor - foot.yaw) for share, anchor, foot in zip(shares, anchors, feet, strict=True))
        held = ca.logic_and(standing, both)
        known = chosen(held, known.heading_turned(dt / table.heading_time_constant * turn), known)
        heading_variance += ca.if_else(held, 0.0, table.heading_walk**2 * dt)

        after = Memory(
            ca.vertcat(*known.numbers),
            *odometry,
            ca.horzcat(left.past.numbers, right.past.numbers).T,
            ca.vertcat(*surprise),
            ca.vertcat(*anchors),
            heading_variance,
            memory.joint_velocity,
        )
        com_velocity = odometry.state[VELOCITY, :].T + com_moving
        sent = self._of_base(known, odometry, com, com_velocity, heading_variance) | {
            "pelvis_rotation_in_odom": turned,
            "pelvis_angular_velocity_in_pelvis": rates[:3],
            **self._of_feet(feet, odometry, places),
            "sole_rotations_in_odom": sole_rotations,
            "pelvis_in_support": _in_support(turned, places, rotations),
        }
        return *after, ca.vertcat(*(ca.vec(sent[name].T) for name in SENT)), ca.vertcat(left.touching, right.touching)

    def _felt(
        self,
        memory: Memory,
        measured: Measured,
        rotations: Sequence[Expression],
        places: Sequence[Expression],
        dt: Expression,
    ) -> tuple[list[FootContact], Odometry, list[Expression], Expression]:
        """Feet; odometry, headings and their variance, after rolling and landing."""
        table = self._table
        odometry = Odometry(memory.state, memory.covariance, memory.acceleration)
        heading_variance, anchors = memory.heading_variance, list(parts(memory.anchors))
        feet: list[FootContact] = []
        wrenches = (measured.left_foot_wrench, measured.right_foot_wrench)
        for i, sense in enumerate(self._feet):
            foot = sense.feel(Past.of(memory.feet[i, :].T), rotations[i], wrenches[i], memory.surprise[i], dt)
            feet.append(foot)
            rolling = ca.if_else(ca.logic_and(foot.touching, ca.logic_not(foot.landed)), foot.rolled, 0.0)
            state = ca.SX(odometry.state)
            state[FEET + i, :] += rolling.T
            odometry = odometry._replace(state=state)
            odometry = odometry.placed(i, foot.landed, places[i], table.foothold_deviation**2)
            # A foot that surely stands keeps its heading; else the heading follows the foot.
            share = ca.if_else(foot.touching, ca.if_else(foot.landed, 1.0, 1.0 - foot.probability), 0.0)
            anchors[i] += share * (foot.yaw - anchors[i])
            heading_variance += ca.if_else(foot.landed, table.foothold_heading_deviation**2, 0.0)
        return feet, odometry, anchors, heading_variance

    def _of_base(
        self,
        known: Attitude,
        odometry: Odometry,
        com: Expression,
        com_velocity: Expression,
        heading_variance: Expression,
    ) -> dict[str, Expression]:
        """Floating base and CoM by the names of ``SENT``; ``com`` (3,) is from the pelvis."""
        base, covariance = odometry.state[POSITION, :].T, odometry.covariance
        level = covariance[BIAS, BIAS] / self._kinematics.gravity**2
        return {
            "pelvis_position_in_odom": base,
            "pelvis_orientation_in_odom": ca.vertcat(*known.orientation),
            "pelvis_linear_velocity_in_odom": odometry.state[VELOCITY, :].T,
            "com_in_odom": base + com,
            "com_velocity_in_odom": com_velocity,
            "dcm_in_odom": base + com + com_velocity * self._inverse_omega,
            "pelvis_position_variance": ca.repmat(covariance[POSITION, POSITION], 3),
            # The accelerometer's error determines the uncertainty of the level.
            "pelvis_orientation_variance": ca.vertcat(level, level, heading_variance)
            + self._table.attitude_deviation**2,
            "pelvis_linear_velocity_variance": ca.repmat(covariance[VELOCITY, VELOCITY], 3),
        }

    @staticmethod
    def _of_feet(
        feet: Sequence[FootContact], odometry: Odometry, places: Sequence[Expression]
    ) -> dict[str, Expression]:
        left, right = feet
        base = odometry.state[POSITION, :].T
        return {
            "contact_probability": ca.vertcat(left.probability, right.probability),
            "foot_forces": ca.vertcat(left.force, right.force),
            "cop_in_odom": base[:2] + _cop(feet, places),
            "sole_positions_in_odom": ca.horzcat(base + places[0], base + places[1]).T,
        }

    def _wander(self, left: FootContact, right: FootContact) -> tuple[Expression, Expression]:
        """Growth of each foothold's variance [m²/s]: small with both feet down, more with one, most slipping."""
        creep, slip = self._table.creep**2, self._table.slip**2
        creep += (1.0 - ca.fmin(left.probability, right.probability)) * self._table.creep_alone**2
        return creep + (1.0 - left.probability) * slip, creep + (1.0 - right.probability) * slip

    def _by_legs(
        self,
        feet: Sequence[FootContact],
        shares: Sequence[Expression],
        places: Sequence[Expression],
        jacobian: Expression,
        rates: Expression,
    ) -> tuple[Expression, Expression]:
        """(4, 3) measurements of the legs and (4,) variances, from (3,) ``places`` of the soles, in odom's axes [m]."""
        place, rate = self._table.leg_position_deviation**2, self._table.leg_velocity_deviation**2
        velocities, doubts = [], []
        for i, foot in enumerate(feet):
            moving = self._kinematics.sole_dofs[i]
            rows = jacobian[6 * i : 6 * i + 6, moving] @ rates[[dof - 3 for dof in moving]]
            # Velocity of the pelvis from the centre of pressure, which is at rest: −(v + ω×r).
            velocities.append(-(rows[:3] + ca.cross(rows[3:], foot.cop)))
            # If two feet disagree, the one with less weight is more likely to slip.
            doubts.append(ca.if_else(foot.touching, 0.5 / (shares[i] * foot.probability**2), NOTHING / place))
        measured = ca.horzcat(*places, *velocities).T
        return measured, ca.vertcat(*(place * doubt for doubt in doubts), *(rate * doubt for doubt in doubts))

    def _levelled(
        self, known: Attitude, odometry: Odometry, turned: Expression, middle: Expression
    ) -> tuple[Odometry, Attitude]:
        """Rotate the attitude by the accelerometer's bias, and the pelvis about ``middle``, the loaded feet [m]."""
        state, g = ca.SX(odometry.state), self._kinematics.gravity
        tilt = ca.vertcat(state[BIAS, 1] / g, -state[BIAS, 0] / g, 0.0)
        levelled, taken = known.tilted(parts(turned.T @ tilt))
        state[BIAS, :2] = 0.0
        state[POSITION, :] -= ca.if_else(taken, ca.cross(tilt, middle), 0.0).T
        return odometry._replace(state=state), levelled


def _in_support(pelvis: Expression, places: Sequence[Expression], rotations: Sequence[Expression]) -> Expression:
    """(6,) ``RobotState.pelvis_in_support``; arguments as in ``RobotState``, ``places`` from the pelvis."""
    left, right = rotations
    heading = ca.atan2(left[1, 0] + right[1, 0], left[0, 0] + right[0, 0])
    away = -0.5 * (places[0] + places[1])
    along, across = ca.vertcat(ca.cos(heading), ca.sin(heading)), ca.vertcat(-ca.sin(heading), ca.cos(heading))
    roll, pitch, yaw = roll_pitch_yaw(pelvis)
    turn = yaw - heading
    return ca.vertcat(
        ca.dot(along, away[:2]),
        ca.dot(across, away[:2]),
        away[2],
        roll,
        pitch,
        ca.atan2(ca.sin(turn), ca.cos(turn)),
    )


def _cop(feet: Sequence[FootContact], places: Sequence[Expression]) -> Expression:
    """(2,) centre of pressure of both feet, from the pelvis, in odom's axes [m]; NaN without contact."""
    loads = [ca.if_else(foot.touching, foot.force, 0.0) for foot in feet]
    total = loads[0] + loads[1]
    cop = sum(load / total * (place + foot.cop) for load, place, foot in zip(loads, places, feet, strict=True))
    return ca.if_else(total > 0.0, cop[:2], ca.DM.nan(2))
