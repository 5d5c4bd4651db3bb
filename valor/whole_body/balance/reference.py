"""The reference of balance: from the state as it is, smoothly, to the nominal stance over the feet; or along a gait.

All start values fade out by one minimum-jerk blend s(t) (Flash & Hogan 1985). The CoM ends over the support's centre at
its nominal height, moved with the arms (``arms``) and as the pelvis is led (``pelvis``); pelvis and chest end level,
heading as the feet do, turned as the pelvis is led. While the robot steps, DCM and VRP are those of its gait, moved
likewise. All of it is expressions of ``kernel``, which ``tasks.desired`` evaluates.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from valor.common import rotation
from valor.common.kernel import Expression, clipped
from valor.common.turns import turned
from valor.robot.description import RobotDescription
from valor.whole_body.tuning_tables import Tuning


def minimum_jerk(time: Expression, duration: float) -> tuple[Expression, Expression, Expression]:
    """s, ṡ [1/s], s̈ [1/s²] of the blend from 0 at 0 to 1 at ``duration`` [s]."""
    x = ca.fmin(time / duration, 1.0)
    return (
        x * x * x * (10.0 + x * (6.0 * x - 15.0)),
        30.0 * x * x * (1.0 + x * (x - 2.0)) / duration,
        60.0 * x * (1.0 + x * (2.0 * x - 3.0)) / (duration * duration),
    )


def followed(state: Expression, target: Expression, bandwidth: float, dt: Expression) -> Expression:
    """A critically damped second-order filter, with the derivatives of what it gives: ẍ = ω²·(u − x) − 2ω·ẋ.

    Args:
        state: (3, k) rows x, ẋ [1/s], ẍ [1/s²].
        target: (k,) u.
        bandwidth: ω [rad/s].
        dt: for which it follows, short beside 1/ω [s].

    Returns:
        (3, k) the state afterwards.
    """
    place, rate = state[0, :], state[1, :]
    acceleration = bandwidth**2 * (target.T - place) - 2.0 * bandwidth * rate
    rate = rate + dt * acceleration
    return ca.vertcat(place + dt * rate, rate, acceleration)


class Feet(NamedTuple):
    """Where the soles are in odom."""

    positions: Expression  # (2, 3) [m]
    rotations: Expression  # (6, 3) left above right

    def level(self) -> Expression:
        """(3, 3) upright, heading as the feet do."""
        across = self.rotations[0, 0] + self.rotations[3, 0], self.rotations[1, 0] + self.rotations[4, 0]
        yaw = ca.atan2(across[1], across[0])
        c, s = ca.cos(yaw), ca.sin(yaw)
        return ca.vertcat(ca.horzcat(c, -s, 0.0), ca.horzcat(s, c, 0.0), ca.horzcat(0.0, 0.0, 1.0))


class Led(NamedTuple):
    """How the pelvis is led (``pelvis``), and what the arms do to the CoM and the chest (``arms``)."""

    rotation: Expression  # (3, 3) of the pelvis in support
    angular_velocity: Expression  # (3,) likewise [rad/s]
    com: Expression  # (3,) that the CoM is to move, in support [m]
    arms_com: Expression  # (3,) that it moves with the arms, in pelvis [m]
    chest: Expression  # (3, 3) in pelvis


class Begun(NamedTuple):
    """What the reference keeps from period to period."""

    time: Expression  # (1,) since the start [s]
    support: Expression  # (3,) the CoM over the soles, followed slowly [m]
    shift: Expression  # (3, 3) of the CoM, as of ``followed``
    offsets: Expression  # (3, 3) at the start: CoM [m], pelvis, chest [rad]; none of the CoM's after a step


class Reference(NamedTuple):
    """Where things shall be, in odom."""

    dcm: Expression  # (3,) [m]
    vrp: Expression  # (3,) [m]
    shift: Expression  # (3,) of the DCM, that the arms are not nominal [m]
    centre_dcm: Expression  # (3,) of a robot with nominal arms [m]
    centre_vrp: Expression  # (3,) likewise [m]
    turning: Expression  # (3,) angular velocity of pelvis and chest, as the pelvis is led [rad/s]
    legs_blend: Expression  # s, of the leg joints from where they were to nominal
    pelvis: Expression  # (3, 3)
    chest: Expression  # (3, 3)


class StandReference:
    """The reference of a robot."""

    def __init__(self, robot: RobotDescription, omega: float, com_height: float) -> None:
        """Args: omega: ω [1/s]. com_height: of the CoM above the soles in the nominal posture [m]."""
        table = robot.read(Tuning).whole_body
        self._table, self._omega = table, omega
        limit = table.com_shift_limit
        self._limit = ca.DM((limit, limit, np.inf)) if limit else ca.DM.zeros(3)
        feet = robot.tables.feet
        inside = min(foot.toe - foot.heel for foot in (feet.left, feet.right)) / 2.0 - robot.tables.pelvis.com_margin
        self._inside = ca.DM((inside, inside, np.inf))
        self._centres = [ca.DM(((foot.heel + foot.toe) / 2.0, 0.0, 0.0)) for foot in (feet.left, feet.right)]
        self._height = ca.DM((0.0, 0.0, com_height))

    def begin(self, feet: Feet, led: Led, com: Expression, pelvis: Expression, chest: Expression) -> Begun:
        """At rest, from the CoM (3,) [m] and the rotations (3, 3) of pelvis and chest in odom: all numbers."""
        level = feet.level()
        shift, support = self._shift(level, led), self._support(feet)
        offsets = (
            com - support - shift,
            _vector(pelvis @ level.T),
            _vector(chest @ (level @ led.chest).T),
        )
        return Begun(ca.DM.zeros(1), support, ca.horzcat(shift, ca.DM.zeros(3, 2)).T, ca.horzcat(*offsets).T)

    def advance(
        self, begun: Begun, feet: Feet, led: Led, gait: tuple[Expression, Expression, Expression], dt: Expression
    ) -> tuple[Begun, Reference]:
        """One period on.

        Args:
            begun: of the last period.
            feet: as they are.
            led: as commanded.
            gait: whether the robot steps; (3,) DCM and (3,) VRP of its gait then [m].
            dt: since the last period [s].
        """
        table, omega = self._table, self._omega
        steps, gait_dcm, gait_vrp = gait
        level, time = feet.level(), begun.time + dt
        support = begun.support + (self._support(feet) - begun.support) * (table.support_bandwidth * dt)
        shift = followed(begun.shift, self._shift(level, led), table.com_shift_bandwidth, dt)
        s, rate, acceleration = minimum_jerk(time, table.blend_duration)
        left, offsets = 1.0 - s, begun.offsets
        # DCM x + ẋ/ω and VRP x − ẍ/ω² of a CoM x
        centre_dcm = ca.if_else(steps, gait_dcm, support + (left - rate / omega) * offsets[0, :].T)
        centre_vrp = ca.if_else(steps, gait_vrp, support + (left + acceleration / omega**2) * offsets[0, :].T)
        shift_dcm = (shift[0, :] + shift[1, :] / omega).T
        shift_vrp = (shift[0, :] - shift[2, :] / omega**2).T
        pelvis = level @ led.rotation
        reference = Reference(
            dcm=centre_dcm + shift_dcm,
            vrp=centre_vrp + shift_vrp,
            shift=shift_dcm,
            centre_dcm=centre_dcm,
            centre_vrp=centre_vrp,
            turning=level @ led.angular_velocity,
            legs_blend=s,
            pelvis=turned(left * offsets[1, :].T) @ pelvis,
            chest=turned(left * offsets[2, :].T) @ pelvis @ led.chest,
        )
        com_offset = ca.if_else(steps, 0.0, offsets[0, :])
        support = ca.if_else(steps, centre_vrp, support)  # where standing goes on from
        return Begun(time, support, shift, ca.vertcat(com_offset, offsets[1:, :])), reference

    def _support(self, feet: Feet) -> Expression:
        """(3,) of the CoM over the middle of both soles at nominal height, in odom [m]."""
        middles = (feet.positions[i, :].T + feet.rotations[3 * i : 3 * i + 3, :] @ self._centres[i] for i in range(2))
        return 0.5 * sum(middles) + self._height

    def _shift(self, level: Expression, led: Led) -> Expression:
        """(3,) of the CoM with the arms, limited, and with the pelvis; both together well inside the soles."""
        shift = clipped(led.rotation @ led.arms_com, -self._limit, self._limit)
        return level @ clipped(shift + led.com, -self._inside, self._inside)


def _vector(matrix: Expression) -> Expression:
    """(3,) axis·θ [rad] of a (3, 3) rotation below π."""
    return ca.DM(rotation.rotation_vector(np.array(ca.DM(matrix))))
