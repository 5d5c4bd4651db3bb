"""Key poses seen by MuJoCo, which knows nothing of how they were found: do they stand, and what touches what?"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.planning.key_poses import KeyPose
from valor.planning.plan_table import ContactPoints
from valor.planning.posture import SagittalPosture, ends


@dataclass(frozen=True, slots=True)
class Check:
    """What MuJoCo finds.

    Attributes:
        unbalanced: (6,) force [N] and moment [N·m] on the pelvis that nothing balances.
        torque: largest share of a joint's limit.
        depth: of the lowest shape below the floor [m]; negative: all are above.
        collisions: pairs of bodies that are in one another by more than 5 mm.
    """

    unbalanced: FloatArray
    torque: float
    depth: float
    collisions: tuple[tuple[str, str], ...]


TOUCHING = 0.005  # deeper than this in one another, bodies collide [m]


def check(posture: SagittalPosture, contacts: Mapping[str, ContactPoints], pose: KeyPose) -> Check:
    """A pose with its forces on both sides, in a MuJoCo model that has every joint."""
    model = posture.model
    mj = model.mj
    data = mujoco.MjData(mj)
    data.qpos[:] = posture.qpos(pose.coordinates)
    mujoco.mj_forward(mj, data)
    rest = data.qfrc_bias.copy()  # of gravity alone: nothing moves
    jacobian = np.zeros((3, mj.nv))
    for name, forces in pose.forces.items():
        contact = contacts[name]
        sides = {posture.sides.body(contact.body): (1.0, -1.0, 1.0)} | {contact.body: (1.0, 1.0, 1.0)}
        for body, side in sides.items():
            number = model.body(body)
            for point, force in zip(contact.points, forces, strict=True):
                place = data.xpos[number] + data.xmat[number].reshape(3, 3) @ (np.array(point) * side)
                place[2] -= contact.radius
                mujoco.mj_jac(mj, data, jacobian, None, place, number)
                rest -= jacobian.T @ (force * side)
    shares = np.abs(rest[model.dof]) / model.robot.effort_limit[model.joint_indices]
    low = min(
        float((data.geom_xpos[g] + data.geom_xmat[g].reshape(3, 3) @ p)[2] - r)
        for g in range(mj.ngeom)
        for points, r in [ends(mj, g)]
        for p in points
    )
    return Check(rest[:6], float(shares.max()), -low, _collisions(mj, data))


def _collisions(mj: mujoco.MjModel, data: mujoco.MjData) -> tuple[tuple[str, str], ...]:
    """Pairs of bodies of the robot that MuJoCo holds apart and that are in one another."""
    pairs = {
        tuple(sorted(mj.body(mj.geom_bodyid[geom]).name for geom in data.contact.geom[i]))
        for i in range(data.ncon)
        if data.contact.dist[i] < -TOUCHING
    }
    return tuple(sorted((pair[0], pair[1]) for pair in pairs))
