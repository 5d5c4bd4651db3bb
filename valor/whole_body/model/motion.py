"""What tasks may want of the robot: motions, whose acceleration is J·v̇ + drift and whose velocity is J·v.

Each kind of motion is a class here. The tasks name theirs, and ``Motions`` puts them one below the other: it alone
knows which rows are whose.

The centroidal quantities are in the pelvis rows of the equations of motion already (Orin & Goswami 2008; Wensing & Orin
2016); r is the CoM from the pelvis, R the pelvis' rotation.
"""

from __future__ import annotations

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

FEET = "feet"  # the motion of the soles: estimator and contacts need it, too


class Base(NamedTuple):
    """The floating base as MuJoCo has found it, with the pelvis at the origin and without linear velocity."""

    rotation: Expression  # (3, 3) of the pelvis in odom
    mass_rows: Expression  # (6, nv) of the mass matrix
    bias: Expression  # (6,)
    com: Expression  # (3,) from the pelvis, in odom's axes [m]
    velocity: Expression  # (nv,)
    up: Expression  # (3,) MuJoCo accelerates the world upwards in gravity's place [m/s²]
    mass: float  # [kg]


class Found(NamedTuple):
    """A motion's part of the kernel, as expressions."""

    drift: Expression  # (rows,) its acceleration at v̇ = 0
    velocity: Expression  # (rows,) relative to the pelvis' linear velocity
    jacobian: Expression | None = None  # (rows, nv); None: MuJoCo writes it
    pose: Expression | None = None  # (size,) of where it leads


class Motion(ABC):
    """Rows of the Jacobian.

    Attributes:
        rows: how many.
        size: numbers of its pose.
        taken: arrays of MuJoCo's that ``find`` takes.
        in_kernel: whether ``find`` finds the Jacobian, and not MuJoCo.
    """

    rows = 3
    size = 0
    taken = 0
    in_kernel = True

    @property
    def carried(self) -> FloatArray:
        """(rows, 3) what the pelvis' linear velocity adds to the velocity."""
        return np.zeros((self.rows, 3))

    def calls(self, data: mujoco.MjData, rows: FloatArray) -> Sequence[Callable[[], None]]:
        """What writes the Jacobian into (rows, nv) ``rows``, where that is MuJoCo's."""
        return ()

    def inputs(self, data: mujoco.MjData) -> Sequence[FloatArray]:
        """Arrays of MuJoCo's that ``find`` takes as symbols."""
        return ()

    @abstractmethod
    def find(self, base: Base, *inputs: Expression) -> Found:
        """Its part of the kernel."""


class CentreOfMassMotion(Motion):
    """c [m/s²], from the pelvis rows: m·c̈ = M₀₋₂·v̇ + h₀₋₂ + m·g."""

    @property
    def carried(self) -> FloatArray:
        """It moves with the pelvis."""
        return np.eye(3)

    def find(self, base: Base, *inputs: Expression) -> Found:
        """Its part of the kernel."""
        linear = base.mass_rows[:3, :]
        return Found(
            base.bias[:3] / base.mass - base.up, linear @ base.velocity / base.mass, jacobian=linear / base.mass
        )


class MomentumMotion(Motion):
    """k about the CoM [N·m], from the pelvis rows: k̇ = R·(M₃₋₅·v̇ + h₃₋₅) − r×(M₀₋₂·v̇ + h₀₋₂)."""

    def find(self, base: Base, *inputs: Expression) -> Found:
        """Its part of the kernel."""
        lever, turned = ca.skew(base.com), base.rotation
        linear, angular = base.mass_rows[:3, :], base.mass_rows[3:, :]
        return Found(
            turned @ base.bias[3:] - lever @ base.bias[:3],
            turned @ (angular @ base.velocity) - lever @ (linear @ base.velocity),
            jacobian=turned @ angular - lever @ linear,
        )


class PelvisTurn(Motion):
    """The pelvis' rotation in odom; its pose: (9,) the matrix, row by row."""

    size = 9

    def find(self, base: Base, *inputs: Expression) -> Found:
        """Its part of the kernel."""
        turned, nv = base.rotation, base.velocity.shape[0]
        return Found(
            ca.SX.zeros(3),
            turned @ base.velocity[3:6],
            jacobian=ca.horzcat(ca.SX(3, 3), turned, ca.SX(3, nv - 6)),
            pose=ca.vec(turned.T),
        )


class BodyTurn(Motion):
    """A body's rotation in odom; its pose: (9,) the matrix, row by row."""

    size = 9
    taken = 3
    in_kernel = False

    def __init__(self, model: Model, body: str) -> None:
        """Of the body of this name."""
        self._model, self._body = model.mj, model.body(body)

    def calls(self, data: mujoco.MjData, rows: FloatArray) -> Sequence[Callable[[], None]]:
        """MuJoCo writes the Jacobian."""
        return (partial(mujoco.mj_jacBody, self._model, data, None, rows, self._body),)

    def inputs(self, data: mujoco.MjData) -> Sequence[FloatArray]:
        """Of the body: spatial acceleration at v̇ = 0 and velocity, angular above linear at the CoM; rotation."""
        return data.cacc[self._body], data.cvel[self._body], data.xmat[self._body]

    def find(self, base: Base, *inputs: Expression) -> Found:
        """Its part of the kernel."""
        acceleration, velocity, turned = inputs
        return Found(acceleration[:3], velocity[:3], pose=turned)


class SoleMotions(Motion):
    """Both soles: left linear, left angular, right linear, right angular.

    Their pose: (6,) places from the pelvis in odom's axes [m], then (18,) rotations in odom, row by row.
    """

    rows = 12
    size = 24
    taken = 8
    in_kernel = False

    def __init__(self, model: Model) -> None:
        """Of the robot's feet."""
        feet, self._model = model.robot.tables.feet, model.mj
        self._sites = [model.site(foot.sole) for foot in (feet.left, feet.right)]
        self._bodies = [int(model.mj.site_bodyid[site]) for site in self._sites]

    @property
    def carried(self) -> FloatArray:
        """Their places move with the pelvis."""
        return np.tile(np.vstack((np.eye(3), np.zeros((3, 3)))), (2, 1))

    def calls(self, data: mujoco.MjData, rows: FloatArray) -> Sequence[Callable[[], None]]:
        """MuJoCo writes the Jacobians."""
        places = (rows[:3], rows[3:6]), (rows[6:9], rows[9:])
        return [
            partial(mujoco.mj_jacSite, self._model, data, *pair, site)
            for pair, site in zip(places, self._sites, strict=True)
        ]

    def inputs(self, data: mujoco.MjData) -> Sequence[FloatArray]:
        """Of both feet: spatial accelerations at v̇ = 0 and velocities, as of a body; places and rotations of soles."""
        of_bodies = [array[body] for array in (data.cacc, data.cvel) for body in self._bodies]
        return *of_bodies, *(array[site] for array in (data.site_xpos, data.site_xmat) for site in self._sites)

    def find(self, base: Base, *inputs: Expression) -> Found:
        """Their part of the kernel: at the sole, r from the CoM, a + α×r + ω×(v + ω×r)."""
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
    """Motions one below the other.

    Attributes:
        rows: of each in Jacobian, drift, velocity and wanted acceleration, by name.
        poses: of each among the numbers of all poses, by name.
        count: of all rows. size: of all poses.
        carried: (count, 3) what the pelvis' linear velocity adds to the velocities.
        in_kernel: rows whose Jacobian is found by expressions, and not by MuJoCo.
    """

    def __init__(self, motions: Mapping[str, Motion]) -> None:
        """These, in their order."""
        self._motions = dict(motions)
        self.rows = self._placed([motion.rows for motion in motions.values()])
        self.poses = self._placed([motion.size for motion in motions.values()])
        self.count = sum(motion.rows for motion in motions.values())
        self.size = sum(motion.size for motion in motions.values())
        self.carried = np.vstack([motion.carried for motion in motions.values()])
        self.in_kernel = [self.rows[name] for name, motion in motions.items() if motion.in_kernel]

    def _placed(self, sizes: Sequence[int]) -> dict[str, slice]:
        places = [slice(*ends) for ends in pairwise(accumulate(sizes, initial=0))]
        return dict(zip(self._motions, places, strict=True))

    def calls(self, data: mujoco.MjData, jacobian: FloatArray) -> list[Callable[[], None]]:
        """What writes MuJoCo's rows of (count, nv) ``jacobian``."""
        return [
            call for name, motion in self._motions.items() for call in motion.calls(data, jacobian[self.rows[name]])
        ]

    def inputs(self, data: mujoco.MjData) -> list[FloatArray]:
        """Arrays of MuJoCo's that ``find`` takes as symbols."""
        return [array for motion in self._motions.values() for array in motion.inputs(data)]

    def find(self, base: Base, inputs: Sequence[Expression]) -> list[Expression]:
        """(count,) drifts, (count,) velocities, (size,) poses; then the Jacobians that are ``in_kernel``."""
        given = iter(inputs)
        found = [motion.find(base, *islice(given, motion.taken)) for motion in self._motions.values()]
        return [
            ca.vertcat(*(each.drift for each in found)),
            ca.vertcat(*(each.velocity for each in found)),
            ca.vertcat(*(each.pose for each in found if each.pose is not None)),
            *(each.jacobian for each in found if each.jacobian is not None),
        ]
