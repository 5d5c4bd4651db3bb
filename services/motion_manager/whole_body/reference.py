"""The reference of standing: from the state as it is, smoothly, to the nominal stance over the feet.

All start values fade out by one minimum-jerk blend s(t) (Flash & Hogan 1985). The CoM ends over the support's centre at
its nominal height, moved with the arms (``arms``); pelvis and chest end level, heading as the feet do.
"""

from __future__ import annotations

import numpy as np

from motion_manager.whole_body import rotation
from motion_manager.whole_body.arms import UpperBodyKinematics
from motion_manager.whole_body.state import FloatArray, RobotState
from valor_common.model import Model
from valor_common.robot import WholeBody


def minimum_jerk(time: float, duration: float) -> tuple[float, float, float]:
    """s, ṡ [1/s], s̈ [1/s²] of the blend from 0 at 0 to 1 at ``duration`` [s]."""
    if time >= duration:
        return 1.0, 0.0, 0.0
    x = time / duration
    return (
        x * x * x * (10.0 + x * (6.0 * x - 15.0)),
        30.0 * x * x * (1.0 + x * (x - 2.0)) / duration,
        60.0 * x * (1.0 + x * (2.0 * x - 3.0)) / (duration * duration),
    )


class Follower:
    """A critically damped second-order filter, with the derivatives of what it gives out.

    Attributes:
        value: (k,). rate: (k,) [1/s]. acceleration: (k,) [1/s²].
    """

    def __init__(self, size: int, bandwidth: float) -> None:
        """Args: size: k. bandwidth: [rad/s]."""
        self._bandwidth = bandwidth
        self.value, self.rate, self.acceleration = np.zeros(size), np.zeros(size), np.zeros(size)

    def reset(self, value: FloatArray) -> None:
        """Stand still at ``value``."""
        self.value[:] = value
        self.rate[:] = 0.0
        self.acceleration[:] = 0.0

    def update(self, target: FloatArray, dt: float) -> None:
        """Follow ``target``: ẍ = ω²·(x_target − x) − 2ω·ẋ."""
        w = self._bandwidth
        self.acceleration[:] = (target - self.value) * (w * w) - self.rate * (2.0 * w)
        self.rate += self.acceleration * dt
        self.value += self.rate * dt


class StandReference:
    """Where CoM, DCM, VRP, chest, pelvis and legs shall be.

    Attributes:
        dcm: (3,), vrp: (3,) in odom [m].
        pelvis: (3, 3), chest: (3, 3) in odom.
        legs_blend: s, of the leg joints from where they were to nominal.
    """

    def __init__(self, model: Model, table: WholeBody, omega: float, upper_body: UpperBodyKinematics) -> None:
        self._upper_body = upper_body
        self._omega = omega
        self._duration = table.blend_duration
        self._limit = np.array((table.com_shift_limit, table.com_shift_limit, np.inf))
        feet = model.robot.tables.feet
        self._centres = np.array([((foot.heel + foot.toe) / 2.0, 0.0, 0.0) for foot in (feet.left, feet.right)])
        self._support = Follower(3, table.support_bandwidth)
        self._shift = Follower(3, table.com_shift_bandwidth)
        self._time = 0.0
        self._com_offset = np.zeros(3)
        self._pelvis_offset = np.zeros(3)
        self._chest_offset = np.zeros(3)
        self.dcm, self.vrp = np.zeros(3), np.zeros(3)
        self.pelvis, self.chest = np.eye(3), np.eye(3)
        self.legs_blend = 0.0

    def reset(self, state: RobotState) -> None:
        """Start from ``state``, at rest."""
        self._time = 0.0
        self._support.reset(self._support_centre(state))
        level = self._level(state)
        self._shift.reset(self._clipped_shift(level))
        self._com_offset = state.com_in_odom - self._support.value - self._shift.value
        self._pelvis_offset = rotation.rotation_vector(state.pelvis_rotation_in_odom @ level.T)
        chest = level @ self._upper_body.chest_rotation()
        self._chest_offset = rotation.rotation_vector(state.dynamics.chest_rotation @ chest.T)

    def update(self, state: RobotState, dt: float) -> None:
        """Go on by ``dt`` [s]; ``upper_body`` is at the commanded posture."""
        self._time += dt
        s, rate, acceleration = minimum_jerk(self._time, self._duration)
        self.legs_blend = s
        level = self._level(state)
        self._support.update(self._support_centre(state), dt)
        self._shift.update(self._clipped_shift(level), dt)
        shift, omega = self._shift, self._omega
        com = self._support.value + shift.value + (1.0 - s) * self._com_offset
        self.dcm = com + (shift.rate - rate * self._com_offset) / omega
        self.vrp = com - (shift.acceleration - acceleration * self._com_offset) / (omega * omega)
        self.pelvis = level
        self.chest = level @ self._upper_body.chest_rotation()
        if s < 1.0:
            self.pelvis = rotation.from_rotation_vector((1.0 - s) * self._pelvis_offset) @ self.pelvis
            self.chest = rotation.from_rotation_vector((1.0 - s) * self._chest_offset) @ self.chest

    def _support_centre(self, state: RobotState) -> FloatArray:
        """(3,) of the CoM over the middle of both soles at nominal height, in odom [m]."""
        centre: FloatArray = (state.sole_positions_in_odom[0] + state.sole_positions_in_odom[1]) * 0.5
        turned = state.sole_rotations_in_odom[0] @ self._centres[0] + state.sole_rotations_in_odom[1] @ self._centres[1]
        centre += 0.5 * turned
        centre[2] += self._upper_body.nominal_com_height
        return centre

    def _level(self, state: RobotState) -> FloatArray:
        return rotation.yaw_matrix(
            rotation.mean_yaw(state.sole_rotations_in_odom[0], state.sole_rotations_in_odom[1])
        )

    def _clipped_shift(self, level: FloatArray) -> FloatArray:
        shift: FloatArray = level @ self._upper_body.com_displacement()
        return np.minimum(np.maximum(shift, -self._limit), self._limit)
