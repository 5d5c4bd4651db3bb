"""Reference of balance, and the law of the Divergent Component of Motion (DCM), as expressions of ``kernel``.

The reference blends from the present state to the nominal stance over the feet, or follows a gait. All start values
fade out by one minimum-jerk blend s(t) (Flash & Hogan 1985). The CoM ends over the support centre at its nominal
height, displaced by the arms (``dynamics``) and the commanded pelvis (``pelvis``). Pelvis and chest end level, with the
feet's heading, rotated by the commanded pelvis. While the robot steps, DCM and VRP are those of its gait with the same
displacement.
"""

from dataclasses import dataclass
from math import inf
from typing import NamedTuple

import casadi as ca
import numpy as np

from valor.common import rotation
from valor.common.kernel import Expression, clipped, turned
from valor.control.tuning_tables import Tuning
from valor.robot.description import RobotDescription


@dataclass(frozen=True, slots=True)
class DcmLaw:
    """DCM feedback with bounded integral action: v = v_ref + (1 + k/ω)·(ξ − ξ_ref) + i,   i̇ = k_i·clip(ξ − ξ_ref).

    If ω varies, ω is ω − ω̇/ω here. With v_ref = ξ_ref − ξ̇_ref/ω the error e = ξ − ξ_ref has the dynamics
    ė = −k·e − ω·i: it decays with k, and model errors (masses, their positions) end in i. The integrated error is
    clipped, because a large error is a push. The part of e in the plane above a threshold has a higher gain, so that
    the CoP reaches the sole's edge at once; with k alone it does so at an error of 5 cm. The horizontal acceleration is
    bounded by the friction of the soles under the robot's weight: for more, the QP would press on the ground, and the
    robot would rise.
    """

    omega: Expression  # ω [1/s]
    gain: float  # k [1/s]
    integral_gain: float  # k_i [1/s]
    integral_limit: float  # limit of each component of i [m]
    integral_error: float  # limit of each component of the integrated error [m]
    push_gain: float = 0.0  # added to k for the error above push_error [1/s]
    push_error: float = 0.0  # threshold in the plane [m]
    grip: float = inf  # limit of the acceleration in the plane [m/s²]
    omega_dot: Expression = 0.0  # ω̇ [1/s²]

    @property
    def growth(self) -> Expression:
        """Rate ω − ω̇/ω at which the DCM diverges from the VRP [1/s]."""
        return self.omega - self.omega_dot / self.omega

    @property
    def stiffness(self) -> Expression:
        """Acceleration per distance from the VRP, ω² − ω̇ [1/s²]."""
        return self.omega * self.omega - self.omega_dot

    def repellent_point(
        self, dcm: Expression, reference: Expression, vrp_reference: Expression, integral: Expression, dt: Expression
    ) -> tuple[Expression, Expression]:
        """Return (3,) v and the new (3,) i [m] from DCM, reference and reference VRP, (3,) in odom [m], and i."""
        error = dcm - reference
        slow = clipped(error, -self.integral_error, self.integral_error)
        integral = integral + self.integral_gain * dt * slow
        integral = clipped(integral, -self.integral_limit, self.integral_limit)
        size = _in_plane(error)
        beyond = ca.if_else(size > self.push_error, 1.0 - self.push_error / size, 0.0)
        pushed = ca.vertcat(error[:2], 0.0) * beyond
        proportional = (1.0 + self.gain / self.growth) * error + self.push_gain / self.growth * pushed
        return vrp_reference + proportional + integral, integral

    def acceleration(self, com: Expression, repellent_point: Expression) -> Expression:
        """Return (3,) c̈ = (ω² − ω̇)·(c − v) [m/s²], in the plane at most ``grip``."""
        wanted = (com - repellent_point) * self.stiffness
        size = _in_plane(wanted)
        share = ca.if_else(size > self.grip, self.grip / size, 1.0)
        return ca.vertcat(share * wanted[:2], wanted[2])


def _in_plane(vector: Expression) -> Expression:
    """Length of (3,) in the plane."""
    return ca.sqrt(vector[0] * vector[0] + vector[1] * vector[1])


def at_frequency(dcm: Expression, com: Expression, ratio: Expression) -> Expression:
    """Return (3,) the DCM of the same motion for ω/``ratio`` in place of ω, from that for ω and the CoM [m]."""
    return dcm + (ratio - 1.0) * (dcm - com)


def minimum_jerk(time: Expression, duration: float) -> tuple[Expression, Expression, Expression]:
    """Return s, ṡ [1/s], s̈ [1/s²] of the blend from 0 at time 0 to 1 at ``duration`` [s]."""
    x = ca.fmin(time / duration, 1.0)
    return (
        x * x * x * (10.0 + x * (6.0 * x - 15.0)),
        30.0 * x * x * (1.0 + x * (x - 2.0)) / duration,
        60.0 * x * (1.0 + x * (2.0 * x - 3.0)) / (duration * duration),
    )


def followed(state: Expression, target: Expression, bandwidth: float, dt: Expression) -> Expression:
    """Advance a critically damped filter ẍ = ω²·(u − x) − 2ω·ẋ by ``dt`` [s]; (3, k) rows x, ẋ [1/s], ẍ [1/s²]."""
    place, rate = state[0, :], state[1, :]
    acceleration = bandwidth**2 * (target.T - place) - 2.0 * bandwidth * rate
    rate = rate + dt * acceleration
    return ca.vertcat(place + dt * rate, rate, acceleration)


class Feet(NamedTuple):
    """Poses of the soles in odom."""

    positions: Expression  # (2, 3) [m]
    rotations: Expression  # (6, 3) left above right

    def level(self) -> Expression:
        """Return (3, 3) the level rotation with the mean heading of the feet."""
        across = self.rotations[0, 0] + self.rotations[3, 0], self.rotations[1, 0] + self.rotations[4, 0]
        yaw = ca.atan2(across[1], across[0])
        c, s = ca.cos(yaw), ca.sin(yaw)
        return ca.vertcat(ca.horzcat(c, -s, 0.0), ca.horzcat(s, c, 0.0), ca.horzcat(0.0, 0.0, 1.0))


class Led(NamedTuple):
    """Commanded pelvis (``pelvis``), and effect of the arms on CoM and chest (``UpperBodyKinematics``)."""

    rotation: Expression  # (3, 3) of the pelvis in support
    angular_velocity: Expression  # (3,) of the pelvis in support [rad/s]
    com: Expression  # (3,) displacement of the CoM with the pelvis, in support [m]
    arms_com: Expression  # (3,) displacement of the CoM with the arms, in pelvis [m]
    chest: Expression  # (3, 3) in pelvis


class Begun(NamedTuple):
    """State of the reference between periods."""

    time: Expression  # (1,) since the start [s]
    support: Expression  # (3,) CoM over the soles, low-pass filtered [m]
    shift: Expression  # (3, 3) shift of the CoM, see ``followed``
    offsets: Expression  # (3, 3) offsets at the start: CoM [m], zero after a step; pelvis, chest [rad]


class Reference(NamedTuple):
    """Reference values in odom."""

    dcm: Expression  # (3,) [m]
    vrp: Expression  # (3,) [m]
    shift: Expression  # (3,) part of the DCM due to arms that are not nominal [m]
    centre_dcm: Expression  # (3,) DCM for nominal arms [m]
    centre_vrp: Expression  # (3,) VRP for nominal arms [m]
    turning: Expression  # (3,) commanded angular velocity of pelvis and chest [rad/s]
    legs_blend: Expression  # s of the leg joints, from their start to nominal
    pelvis: Expression  # (3, 3)
    chest: Expression  # (3, 3)


class StandReference:
    """Reference of balance of a robot."""

    def __init__(self, robot: RobotDescription, com_height: float) -> None:
        """Args: com_height: of the CoM above the soles in the nominal posture [m]."""
        table = robot.read(Tuning).whole_body
        self._table = table
        limit = table.com_shift_limit
        self._limit = ca.DM((limit, limit, np.inf)) if limit else ca.DM.zeros(3)
        feet = robot.tables.feet
        inside = min(foot.toe - foot.heel for foot in (feet.left, feet.right)) / 2.0 - robot.tables.pelvis.com_margin
        self._inside = ca.DM((inside, inside, np.inf))
        self._centres = [ca.DM(((foot.heel + foot.toe) / 2.0, 0.0, 0.0)) for foot in (feet.left, feet.right)]
        self._height = ca.DM((0.0, 0.0, com_height))

    def begin(self, feet: Feet, led: Led, com: Expression, pelvis: Expression, chest: Expression) -> Begun:
        """Start at rest, from (3,) CoM [m] and (3, 3) rotations of pelvis and chest in odom, as numbers."""
        level = feet.level()
        shift, support = self._shift(level, led), self._support(feet)
        offsets = (
            com - support - shift,
            _vector(pelvis @ level.T),
            _vector(chest @ (level @ led.chest).T),
        )
        return Begun(ca.DM.zeros(1), support, ca.horzcat(shift, ca.DM.zeros(3, 2)).T, ca.horzcat(*offsets).T)

    def advance(
        self,
        begun: Begun,
        feet: Feet,
        led: Led,
        gait: tuple[Expression, Expression, Expression],
        dt: Expression,
        *,
        law: DcmLaw,
    ) -> tuple[Begun, Reference]:
        """Advance one period of ``dt`` [s]; ``gait`` is whether the robot steps, and its (3,) DCM and (3,) VRP [m]."""
        table, omega, stiffness = self._table, law.omega, law.stiffness
        steps, gait_dcm, gait_vrp = gait
        level, time = feet.level(), begun.time + dt
        support = begun.support + (self._support(feet) - begun.support) * (table.support_bandwidth * dt)
        shift = followed(begun.shift, self._shift(level, led), table.com_shift_bandwidth, dt)
        s, rate, acceleration = minimum_jerk(time, table.blend_duration)
        left, offsets = 1.0 - s, begun.offsets
        # DCM x + ẋ/ω and VRP x − ẍ/(ω² − ω̇) of a CoM x
        centre_dcm = ca.if_else(steps, gait_dcm, support + (left - rate / omega) * offsets[0, :].T)
        centre_vrp = ca.if_else(steps, gait_vrp, support + (left + acceleration / stiffness) * offsets[0, :].T)
        shift_dcm = (shift[0, :] + shift[1, :] / omega).T
        shift_vrp = (shift[0, :] - shift[2, :] / stiffness).T
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
        support = ca.if_else(steps, centre_vrp, support)  # where standing continues from
        return Begun(time, support, shift, ca.vertcat(com_offset, offsets[1:, :])), reference

    def _support(self, feet: Feet) -> Expression:
        """(3,) CoM over the middle of both soles at nominal height, in odom [m]."""
        middles = (feet.positions[i, :].T + feet.rotations[3 * i : 3 * i + 3, :] @ self._centres[i] for i in range(2))
        return 0.5 * sum(middles) + self._height

    def _shift(self, level: Expression, led: Led) -> Expression:
        """(3,) shift of the CoM with the arms, limited, plus the pelvis; the sum well inside the soles [m]."""
        shift = clipped(led.rotation @ led.arms_com, -self._limit, self._limit)
        return level @ clipped(shift + led.com, -self._inside, self._inside)


def _vector(matrix: Expression) -> Expression:
    """(3,) axis·θ [rad] of a (3, 3) rotation below π."""
    return ca.DM(rotation.rotation_vector(np.array(ca.DM(matrix))))
