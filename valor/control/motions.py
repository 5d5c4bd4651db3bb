"""Motions of the robot: acceleration J·v̇ + drift, velocity J·v.

Each kind of motion is a class. ``Motions`` stacks them and maps names to rows.

The centroidal quantities are in the pelvis rows of the equations of motion (Orin & Goswami 2008; Wensing & Orin 2016);
r is the CoM from the pelvis, R the pelvis' rotation.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import accumulate, islice, pairwise
from typing import NamedTuple

import casadi as ca
import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.kernel import Expression
from valor.robot.model import Model

COM, FEET = "com", "feet"  # motions that the estimator uses, too


class Base(NamedTuple):
    """Floating base from MuJoCo, with the pelvis at the origin and without linear velocity."""

    rotation: Expression  # (3, 3) of the pelvis in odom
    mass_rows: Expression  # (6, nv) of the mass matrix
    bias: Expression  # (6,)
    com: Expression  # (3,) from the pelvis, in odom's axes [m]
    velocity: Expression  # (nv,)
    up: Expression  # (3,) MuJoCo's upward acceleration in place of gravity [m/s²]
    mass: float  # [kg]


class Found(NamedTuple):
    """Part of a motion in the kernel, as expressions."""

    drift: Expression  # (rows,) its acceleration at v̇ = 0
    velocity: Expression  # (rows,) relative to the pelvis' linear velocity
    jacobian: Expression | None = None  # (rows, nv); None: MuJoCo writes it
    pose: Expression | None = None  # (size,)


class Motion(ABC):
    """Rows of the Jacobian."""

    rows = 3  # number of rows
    size = 0  # number of values of its pose
    taken = 0  # number of MuJoCo arrays that ``find`` accepts
    in_kernel = True  # whether ``find`` returns the Jacobian; else MuJoCo writes it

    def carried(self) -> FloatArray:
        """(rows, 3) effect of the pelvis' linear velocity on the velocity."""
        return np.zeros((self.rows, 3))

    def calls(self, data: mujoco.MjData, rows: FloatArray) -> Sequence[Callable[[], None]]:
        """Calls that write the Jacobian from MuJoCo into (rows, nv) ``rows``."""
        return ()

    def inputs(self, data: mujoco.MjData) -> Sequence[FloatArray]:
        """MuJoCo arrays that ``find`` accepts as symbols."""
        return ()

    @abstractmethod
    def find(self, base: Base, *inputs: Expression) -> Found:
        """Return its part of the kernel."""


class CentreOfMassMotion(Motion):
    """c [m/s²], from the pelvis rows: m·c̈ = M₀₋₂·v̇ + h₀₋₂ + m·g."""

    def carried(self) -> FloatArray:
        return np.eye(3)

    def find(self, base: Base, *inputs: Expression) -> Found:
        linear, mass = base.mass_rows[:3, :], base.mass
        return Found(base.bias[:3] / mass - base.up, linear @ base.velocity / mass, jacobian=linear / mass)


class MomentumMotion(Motion):
    """k about the CoM [N·m], from the pelvis rows: k̇ = R·(M₃₋₅·v̇ + h₃₋₅) − r×(M₀₋₂·v̇ + h₀₋₂)."""

    def find(self, base: Base, *inputs: Expression) -> Found:
        lever, turned = ca.skew(base.com), base.rotation
        linear, angular = base.mass_rows[:3, :], base.mass_rows[3:, :]
        return Found(
            turned @ base.bias[3:] - lever @ base.bias[:3],
            turned @ (angular @ base.velocity) - lever @ (linear @ base.velocity),
            jacobian=turned @ angular - lever @ linear,
        )


class PelvisTurn(Motion):
    """Rotation of the pelvis in odom; pose: (9,) matrix, row by row."""

    size = 9

    def find(self, base: Base, *inputs: Expression) -> Found:
        turned, nv = base.rotation, base.velocity.shape[0]
        return Found(
            ca.SX.zeros(3),
            turned @ base.velocity[3:6],
            jacobian=ca.horzcat(ca.SX(3, 3), turned, ca.SX(3, nv - 6)),
            pose=ca.vec(turned.T),
        )


class BodyTurn(Motion):
    """Rotation of a body in odom; pose: (9,) matrix, row by row."""

    size = 9
    taken = 3
    in_kernel = False

    def __init__(self, model: Model, body: str) -> None:
        self._model, self._body = model.mj, model.body(body)

    def calls(self, data: mujoco.MjData, rows: FloatArray) -> Sequence[Callable[[], None]]:
        return (partial(mujoco.mj_jacBody, self._model, data, None, rows, self._body),)

    def inputs(self, data: mujoco.MjData) -> Sequence[FloatArray]:
        # Spatial acceleration at v̇ = 0 and velocity, angular above linear at the CoM; rotation.
        return data.cacc[self._body], data.cvel[self._body], data.xmat[self._body]

    def find(self, base: Base, *inputs: Expression) -> Found:
        acceleration, velocity, turned = inputs
        return Found(acceleration[:3], velocity[:3], pose=turned)


class SoleMotions(Motion):
    """Both soles: left linear, left angular, right linear, right angular.

    Pose: (6,) positions from the pelvis in odom's axes [m], then (18,) rotations in odom, row by row.
    """

    rows = 12
    size = 24
    taken = 8
    in_kernel = False

    def __init__(self, model: Model) -> None:
        feet, self._model = model.robot.tables.feet, model.mj
        self._sites = [model.site(foot.sole) for foot in (feet.left, feet.right)]
        self._bodies = [int(model.mj.site_bodyid[site]) for site in self._sites]

    def carried(self) -> FloatArray:
        return np.tile(np.vstack((np.eye(3), np.zeros((3, 3)))), (2, 1))

    def calls(self, data: mujoco.MjData, rows: FloatArray) -> Sequence[Callable[[], None]]:
        places = (rows[:3], rows[3:6]), (rows[6:9], rows[9:])
        return [
            partial(mujoco.mj_jacSite, self._model, data, *pair, site)
            for pair, site in zip(places, self._sites, strict=True)
        ]

    def inputs(self, data: mujoco.MjData) -> Sequence[FloatArray]:
        of_bodies = [array[body] for array in (data.cacc, data.cvel) for body in self._bodies]
        return *of_bodies, *(array[site] for array in (data.site_xpos, data.site_xmat) for site in self._sites)

    def find(self, base: Base, *inputs: Expression) -> Found:
        # a + α×r + ω×(v + ω×r) at the sole, r from the CoM
        accelerations, velocities, places, turns = (inputs[i : i + 2] for i in range(0, 8, 2))
        drift, moving = [], []
        for acceleration, velocity, place in zip(accelerations, velocities, places, strict=True):
            arm, turning = place - base.com, velocity[:3]
            at_sole = velocity[3:] + ca.cross(turning, arm)
            moving += [at_sole, turning]
            accelerated = acceleration[3:] + ca.cross(acceleration[:3], arm) + ca.cross(turning, at_sole)
            drift += [accelerated - base.up, acceleration[:3]]
        return Found(ca.vertcat(*drift), ca.vertcat(*moving), pose=ca.vertcat(*places, *turns))


class Motions:
    """Stacked motions."""

    def __init__(self, motions: Mapping[str, Motion]) -> None:
        self._motions = dict(motions)
        self.rows = self._placed([motion.rows for motion in motions.values()])  # in Jacobian, drift and velocity
        self.poses = self._placed([motion.size for motion in motions.values()])  # in the pose vector
        self.count = sum(motion.rows for motion in motions.values())
        self.size = sum(motion.size for motion in motions.values())
        self.carried = np.vstack([motion.carried() for motion in motions.values()])  # (count, 3), see ``Motion``
        self.in_kernel = [self.rows[name] for name, motion in motions.items() if motion.in_kernel]

    def _placed(self, sizes: Sequence[int]) -> dict[str, slice]:
        places = [slice(*ends) for ends in pairwise(accumulate(sizes, initial=0))]
        return dict(zip(self._motions, places, strict=True))

    def calls(self, data: mujoco.MjData, jacobian: FloatArray) -> list[Callable[[], None]]:
        """Calls that write MuJoCo's rows of (count, nv) ``jacobian``."""
        return [
            call for name, motion in self._motions.items() for call in motion.calls(data, jacobian[self.rows[name]])
        ]

    def inputs(self, data: mujoco.MjData) -> list[FloatArray]:
        """MuJoCo arrays that ``find`` accepts as symbols."""
        return [array for motion in self._motions.values() for array in motion.inputs(data)]

    def find(self, base: Base, inputs: Sequence[Expression]) -> list[Expression]:
        """Return (count,) drifts, (count,) velocities, (size,) poses, and the Jacobians ``in_kernel``."""
        given = iter(inputs)
        found = [motion.find(base, *islice(given, motion.taken)) for motion in self._motions.values()]
        return [
            ca.vertcat(*(each.drift for each in found)),
            ca.vertcat(*(each.velocity for each in found)),
            ca.vertcat(*(each.pose for each in found if each.pose is not None)),
            *(each.jacobian for each in found if each.jacobian is not None),
        ]
