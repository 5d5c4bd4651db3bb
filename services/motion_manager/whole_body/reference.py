"""The reference of balance: from the state as it is, smoothly, to the nominal stance over the feet; or along a gait.

All start values fade out by one minimum-jerk blend s(t) (Flash & Hogan 1985). The CoM ends over the support's centre at
its nominal height, moved with the arms (``arms``) and as the pelvis is led (``pelvis``); pelvis and chest end level,
heading as the feet do, turned as the pelvis is led. While the robot steps, DCM and VRP are those of its gait, moved
likewise.
"""

from __future__ import annotations

import numpy as np

from motion_manager.whole_body import rotation
from motion_manager.whole_body.arms import UpperBodyKinematics
from motion_manager.whole_body.pelvis import PelvisReference
from motion_manager.whole_body.state import FloatArray, RobotState
from valor_common.model import Model


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
    """A critically damped second-order filter, with the derivatives of what it gives out: ẍ = ω²·(u − x) − 2ω·ẋ.

    Attributes:
        state: (3, 3) rows x, ẋ [1/s], ẍ [1/s²]; columns the components.
    """

    def __init__(self, bandwidth: float) -> None:
        """At rest at the origin.

        Args:
            bandwidth: ω [rad/s].
        """
        self._bandwidth = bandwidth
        self._dt = 0.0
        self._transition, self._input = np.eye(3), np.zeros((3, 1))
        self.state = np.zeros((3, 3))

    def reset(self, value: FloatArray) -> None:
        """Stand still at ``value`` (3,)."""
        self.state[:] = 0.0
        self.state[0] = value

    def update(self, target: FloatArray, dt: float) -> None:
        """Follow u = ``target`` (3,) for ``dt`` [s], which is short beside 1/ω."""
        if dt != self._dt:
            self._set_period(dt)
        self.state = self._transition @ self.state
        self.state += self._input * target

    def _set_period(self, dt: float) -> None:
        w = self._bandwidth
        acceleration = np.array((-w * w, -2.0 * w, 0.0))
        rate = np.array((0.0, 1.0, 0.0)) + dt * acceleration
        self._dt = dt
        self._transition = np.stack((np.array((1.0, 0.0, 0.0)) + dt * rate, rate, acceleration))
        self._input = w * w * np.array(((dt * dt,), (dt,), (1.0,)))


class StandReference:
    """Where CoM, DCM, VRP, chest, pelvis and legs shall be.

    Attributes:
        dcm: (3,), vrp: (3,) in odom [m].
        pelvis: (3, 3), chest: (3, 3) in odom.
        turning: (3,) angular velocity of both, as the pelvis is led, in odom [rad/s].
        legs_blend: s, of the leg joints from where they were to nominal.
        centre_dcm: (3,), centre_vrp: (3,) the same of a robot with nominal arms.
        shift: (3,) of the DCM, that the arms are not nominal [m].
    """

    def __init__(self, model: Model, omega: float, upper_body: UpperBodyKinematics, pelvis: PelvisReference) -> None:
        robot = model.robot
        table = robot.tables.whole_body
        self._upper_body = upper_body
        self._led = pelvis
        self._omega = omega
        self._duration = table.blend_duration
        limit = table.com_shift_limit
        self._limit = np.array((limit, limit, np.inf)) if limit else np.zeros(3)
        feet = robot.tables.feet
        inside = min(foot.toe - foot.heel for foot in (feet.left, feet.right)) / 2.0 - robot.tables.pelvis.com_margin
        self._inside = np.array((inside, inside, np.inf))
        centres = [((foot.heel + foot.toe) / 2.0, 0.0, 0.0) for foot in (feet.left, feet.right)]
        self._centres = np.array(centres)[:, :, None]
        self._height = np.array((0.0, 0.0, upper_body.nominal_com_height))
        self._support_bandwidth = table.support_bandwidth
        self._support = np.zeros(3)
        self._shift = Follower(table.com_shift_bandwidth)
        # DCM x + ẋ/ω and VRP x − ẍ/ω² of a CoM x
        self._points = np.array(((1.0, 1.0 / omega, 0.0), (1.0, 0.0, -1.0 / (omega * omega))))
        self._time = 0.0
        self._com_offset = np.zeros(3)
        self._pelvis_offset = np.zeros(3)
        self._chest_offset = np.zeros(3)
        self.dcm, self.vrp = np.zeros(3), np.zeros(3)
        self.shift = np.zeros(3)
        self.centre_dcm, self.centre_vrp = np.zeros(3), np.zeros(3)
        self.pelvis, self.chest = np.eye(3), np.eye(3)
        self.turning = np.zeros(3)
        self.legs_blend = 0.0

    def reset(self, state: RobotState) -> None:
        """Start from ``state``, at rest."""
        self._time = 0.0
        self._support = self._support_centre(state)
        level = _level(state)
        self._led.reset()
        self._shift.reset(self._clipped_shift(level))
        self._com_offset = state.com_in_odom - self._support - self._shift.state[0]
        self._pelvis_offset = rotation.rotation_vector(state.pelvis_rotation_in_odom @ level.T)
        chest = level @ self._upper_body.chest_rotation()
        self._chest_offset = rotation.rotation_vector(state.dynamics.chest_rotation @ chest.T)

    def update(self, state: RobotState, dt: float, gait: tuple[FloatArray, FloatArray] | None = None) -> None:
        """Go on by one period; ``upper_body`` is at the commanded posture.

        Args:
            state: the estimate.
            dt: since the last [s].
            gait: (3,) DCM and (3,) VRP of the gait while the robot steps; None: it stands.
        """
        self._time += dt
        level = _level(state)
        self._shift.update(self._clipped_shift(level), dt)
        self.pelvis = level @ self._led.rotation
        self.chest = self.pelvis @ self._upper_body.chest_rotation()
        self.turning = level @ self._led.angular_velocity
        self.legs_blend = 1.0
        self._support = self._support + (self._support_centre(state) - self._support) * (self._support_bandwidth * dt)
        self.centre_dcm = self.centre_vrp = self._support
        if self._time < self._duration:
            self._blend_in(*minimum_jerk(self._time, self._duration))
        if gait is not None:
            self.centre_dcm, self.centre_vrp = gait
            self._support = self.centre_vrp  # where standing goes on from
            self._com_offset[:] = 0.0
        points = self._points @ self._shift.state
        self.shift = points[0]
        self.dcm, self.vrp = points[0] + self.centre_dcm, points[1] + self.centre_vrp

    def _blend_in(self, s: float, rate: float, acceleration: float) -> None:
        """Add what is left of the start."""
        omega, left = self._omega, 1.0 - s
        self.legs_blend = s
        self.centre_dcm = self._support + (left - rate / omega) * self._com_offset
        self.centre_vrp = self._support + (left + acceleration / (omega * omega)) * self._com_offset
        self.pelvis = rotation.from_rotation_vector(left * self._pelvis_offset) @ self.pelvis
        self.chest = rotation.from_rotation_vector(left * self._chest_offset) @ self.chest

    def _support_centre(self, state: RobotState) -> FloatArray:
        """(3,) of the CoM over the middle of both soles at nominal height, in odom [m]."""
        centres: FloatArray = np.matmul(state.sole_rotations_in_odom, self._centres)[:, :, 0]
        centres += state.sole_positions_in_odom
        centre: FloatArray = (centres[0] + centres[1]) * 0.5 + self._height
        return centre

    def _clipped_shift(self, level: FloatArray) -> FloatArray:
        """(3,) of the CoM with the arms, limited, and with the pelvis; both together well inside the soles."""
        led = self._led
        shift: FloatArray = led.rotation @ self._upper_body.com_displacement()
        np.maximum(shift, -self._limit, out=shift)
        np.minimum(shift, self._limit, out=shift)
        shift += led.com_displacement
        np.maximum(shift, -self._inside, out=shift)
        np.minimum(shift, self._inside, out=shift)
        result: FloatArray = level @ shift
        return result


def _level(state: RobotState) -> FloatArray:
    """(3, 3) upright, heading as the feet do."""
    return rotation.yaw_matrix(rotation.mean_yaw(state.sole_rotations_in_odom[0], state.sole_rotations_in_odom[1]))
