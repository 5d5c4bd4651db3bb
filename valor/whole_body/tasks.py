"""Tasks of the QP's objective: motions of the robot, their desired accelerations, and weights.

A new task is a class and its line in ``TASKS``; rows, weights and ``<name>_weight`` of the ``whole_body`` table follow.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from math import log
from typing import ClassVar, NamedTuple

import casadi as ca
import numpy as np

from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.common.kernel import Expression, by_rows, clipped, pieces
from valor.control.motions import (
    COM,
    FEET,
    BodyTurn,
    CentreOfMassMotion,
    MomentumMotion,
    Motion,
    Motions,
    PelvisTurn,
    SoleMotions,
)
from valor.control.tuning_tables import Tuning, WholeBody
from valor.robot.description import RobotDescription
from valor.robot.model import Indices, Model
from valor.whole_body.balance.reference import DcmLaw, Feet, Reference

SWING = (3, 9, 6, 6)  # sizes of ``SwingPoint``'s fields
CATCH_UP = 0.5  # Fraction of the velocity limit: largest correction towards a distant reference
DOUBLING_TIME = 0.2  # Shortest time in which a weight doubles or halves [s]


class Period(NamedTuple):
    """Inputs of tasks in a control period, as expressions, in odom."""

    reference: Reference
    law: DcmLaw
    com: Expression  # (3,) [m]
    repellent_point: Expression  # (3,) from the DCM law [m]
    feet: Feet
    stance: Expression  # (3,) held while the robot stands, see ``stance``
    steps: Expression  # whether the robot steps
    swinging: Expression  # (2,) whether the left, the right foot is in the air
    swing: Expression  # (24,) its reference: fields of ``SwingPoint``


class Task(ABC):
    """Task of the objective: ½·w·‖J·v̇ + drift − a‖², with a the desired acceleration of its motion."""

    name: ClassVar[str]  # name of its rows
    weight: ClassVar[str]  # w is ``<weight>_weight`` in the ``whole_body`` table, and can be changed by this name
    default_weight: ClassVar[float] = 0.0  # w if that table has no entry

    def __init__(self, robot: RobotDescription) -> None:
        self.robot = robot

    @staticmethod
    @abstractmethod
    def motion(model: Model) -> Motion:
        """Return the motion that it controls."""

    @abstractmethod
    def acceleration(self, period: Period, velocity: Expression, pose: Expression) -> Expression:
        """Return (rows,) a, from (rows,) velocity and (size,) pose of the motion in odom."""

    def weigh(self, weight: float, swing: tuple[int, float] | None, out: FloatArray) -> None:
        """Write the weights of its rows to (rows,) ``out``; ``swing``: the foot in the air and its weight, or None."""
        out[:] = weight


class CentreOfMass(Task):
    """c̈ = ω²·(c − v) [m/s²], with v the virtual repellent point of the DCM law."""

    name = weight = COM

    @staticmethod
    def motion(model: Model) -> Motion:
        return CentreOfMassMotion()

    def acceleration(self, period: Period, velocity: Expression, pose: Expression) -> Expression:
        return period.law.acceleration(period.com, period.repellent_point)


class AngularMomentum(Task):
    """Damping k̇ = −k_d·k of the angular momentum about the CoM [N·m].

    Its rows have entries of 10 kg·m²: a weight of 0.003 acts like 0.3 on an acceleration.
    """

    name = weight = "angular_momentum"

    @staticmethod
    def motion(model: Model) -> Motion:
        return MomentumMotion()

    def acceleration(self, period: Period, velocity: Expression, pose: Expression) -> Expression:
        return -self.robot.read(Tuning).whole_body.angular_momentum_gain * velocity


class _Orientation(Task):
    """ω̇ = k_p·e + k_d·(ω_ref − ω) [rad/s²] of the body that ``Reference`` has under the task's name.

    e = sin(θ)·axis of the rotation from the actual to the desired orientation (``rotation.error``).
    """

    weight = "orientation"

    def acceleration(self, period: Period, velocity: Expression, pose: Expression) -> Expression:
        table, reference = self.robot.read(Tuning).whole_body, period.reference
        wanted = table.orientation_stiffness * ca.vertcat(*rotation.error(getattr(reference, self.name), by_rows(pose)))
        return wanted + table.orientation_damping * (reference.turning - velocity)


class ChestOrientation(_Orientation):
    """Rotation of the chest."""

    name = "chest"

    @staticmethod
    def motion(model: Model) -> Motion:
        return BodyTurn(model, model.robot.tables.chest)


class PelvisOrientation(_Orientation):
    """Rotation of the pelvis."""

    name = "pelvis"

    @staticmethod
    def motion(model: Model) -> Motion:
        return PelvisTurn()


class FootMotion(Task):
    """Linear [m/s²] and angular [rad/s²] accelerations of the soles.

        standing   a = −k_d·v + hold
        swinging   a = a_ref + k_p·(x_ref − x) + k_d·(v_ref − v)

    with a weight of its own and gains of the ``walking`` table for the swinging foot. The stance is held against creep:
    model errors make the legs push the feet apart, and over an hour small creep becomes a split. The encoders measure
    it: each foot is drawn back by half of the change of distance and relative yaw. The position of both together is not
    controlled.
    """

    name = FEET
    weight = "foot"

    @staticmethod
    def motion(model: Model) -> Motion:
        return SoleMotions(model)

    def acceleration(self, period: Period, velocity: Expression, pose: Expression) -> Expression:
        table = self.robot.read(Tuning).whole_body
        wanted = -table.foot_damping * velocity
        wanted += ca.if_else(period.steps, 0.0, hold(period.feet, period.stance, table.stance_stiffness))
        for foot in range(2):
            rows = sole_rows(foot)
            wanted[rows] = ca.if_else(period.swinging[foot], self._along(foot, period, velocity[rows]), wanted[rows])
        return wanted

    def weigh(self, weight: float, swing: tuple[int, float] | None, out: FloatArray) -> None:
        out[:] = weight
        if swing is not None:
            foot, own = swing
            out[sole_rows(foot)] = own

    def _along(self, foot: int, period: Period, velocity: Expression) -> Expression:
        """(6,) acceleration of the swinging sole."""
        place, turn, rate, acceleration = pieces(period.swing, SWING)
        feet, walking = period.feet, self.robot.tables.walking
        away = place - feet.positions[foot, :].T
        turned = rotation.error(by_rows(turn), feet.rotations[3 * foot : 3 * foot + 3, :])
        proportional = walking.foot_stiffness * ca.vertcat(away, *turned)
        return acceleration + proportional + walking.foot_damping * (rate - velocity)


def sole_rows(foot: int) -> slice:
    """Rows of one sole (0 left, 1 right) among those of both: linear, then angular."""
    return slice(6 * foot, 6 * foot + 6)


def stance(feet: Feet) -> Expression:
    """Return (3,) pose of the left sole relative to the right: forward, left [m], yaw [rad]."""
    cosine, sine, x, y, turned = _relative(feet)
    return ca.vertcat(cosine * x + sine * y, cosine * y - sine * x, turned)


def hold(feet: Feet, kept: Expression, stiffness: float) -> Expression:
    """Return (12,) accelerations of the soles in odom that restore (3,) a stance, with a stiffness [1/s²]."""
    cosine, sine, x, y, turned = _relative(feet)
    ahead, aside, turn = ca.vertsplit(kept)
    left = ca.vertcat(
        cosine * ahead - sine * aside - x, sine * ahead + cosine * aside - y, 0.0, 0.0, 0.0, turn - turned
    )
    return 0.5 * stiffness * ca.vertcat(left, -left)


def _relative(feet: Feet) -> tuple[Expression, Expression, Expression, Expression, Expression]:
    """Heading of the right foot (cosine, sine); left sole from the right: x, y in odom [m], yaw [rad]."""
    apart = feet.positions[0, :] - feet.positions[1, :]
    left, right = feet.rotations[:2, 0], feet.rotations[3:5, 0]
    norm = ca.norm_2(right)
    cosine, sine = right[0] / norm, right[1] / norm
    turned = ca.atan2(cosine * left[1] - sine * left[0], cosine * left[0] + sine * left[1])
    return cosine, sine, apart[0], apart[1], turned


TASKS: tuple[type[Task], ...] = (
    CentreOfMass,
    AngularMomentum,
    ChestOrientation,
    PelvisOrientation,
    FootMotion,
)

ARMS = "arm_posture"
GROUPS = {
    ARMS: ("left_arm", "right_arm"),
    "waist_posture": ("torso",),
    "leg_posture": ("left_leg", "right_leg"),
}
"""Weight of the posture → groups of joints."""

WEIGHTS: tuple[str, ...] = (*dict.fromkeys(task.weight for task in TASKS), *GROUPS)
"""Names of the weights: those of tasks, then of posture groups."""


def motions(model: Model) -> Motions:
    """Return the stacked motions of the tasks."""
    return Motions({task.name: task.motion(model) for task in TASKS})


def nominal_weights(table: WholeBody) -> list[float]:
    """Return ``<name>_weight`` of the table, or the task's default, in the order of ``WEIGHTS``."""
    defaults = {task.weight: task.default_weight for task in TASKS}
    return [float(getattr(table, f"{name}_weight", defaults.get(name, 0.0))) for name in WEIGHTS]


class Posture:
    """Joint posture, arms and waist as commanded, legs nominal or as the commanded pelvis requires [rad/s²].

        q̈ = q̈_ref + k_d·(q̇_ref + clip(k_p/k_d·(q_ref − q)) − q̇)

    clipped to a fraction of the joint's velocity limit.
    """

    def __init__(self, robot: RobotDescription, places: Indices, legs: list[int]) -> None:
        """Create the task: ``places`` of the model's joints among the robot's, ``legs`` among the model's joints."""
        self._table, self._legs = robot.read(Tuning).whole_body, legs
        self._catch_up = ca.DM(CATCH_UP * robot.velocity_limit[places])

    def acceleration(
        self, asked: Expression, legs: Expression, position: Expression, velocity: Expression
    ) -> Expression:
        """Return (nj,) q̈; ``asked`` (3, nj): position, velocity, acceleration; ``legs``: desired angles [rad]."""
        stiffness, damping = self._table.posture_stiffness, self._table.posture_damping
        places, rate, acceleration = (ca.SX(asked[i, :].T) for i in range(3))
        places[self._legs], rate[self._legs], acceleration[self._legs] = legs, 0.0, 0.0
        catch_up = clipped(stiffness / damping * (places - position), -self._catch_up, self._catch_up)
        return acceleration + damping * (rate + catch_up - velocity)


class TaskWeights:
    """Weights that approach the requested ones, so that no torque jumps; (k,) each, in the order of ``WEIGHTS``."""

    def __init__(self, nominal: Sequence[float], factor: float, dt: float) -> None:
        """Start at nominal; limits are nominal times and by ``factor``, ``dt`` is the control period [s]."""
        self.nominal = np.array(nominal)  # those of robot.yaml
        self.lower, self.upper = self.nominal / factor, self.nominal * factor  # limits
        self._step = float(np.exp(log(2.0) * dt / DOUBLING_TIME))
        self.reset()

    def reset(self) -> None:
        """Return to nominal at once, when balance starts."""
        self.requested = self.nominal  # set by clients, within the limits
        self.values = self.nominal.copy()  # active ones

    def advance(self) -> bool:
        """Advance one control period; return whether the weights changed."""
        if self.values is self.requested or np.array_equal(self.values, self.requested):
            return False
        self.values = np.clip(self.requested, self.values / self._step, self.values * self._step)
        return True
