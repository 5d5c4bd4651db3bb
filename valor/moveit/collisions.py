"""Pairs of links that a planner need not look at, found as MoveIt's setup assistant does: by trying.

The assistant leaves out neighbours, what touches in the default state, what touches in nearly every configuration and
what touches in none. Here what touches in a posture that robot.yaml names counts as the default state does. And what
came near in one stays, as does what the Whole-Body Controller keeps apart: by chance hands and far limbs meet so seldom
that ten thousand configurations miss some.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from itertools import combinations

import mujoco
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.robot.description import RobotDescription
from valor.robot.model import Model, compiled, robot_spec
from valor.robot.urdf import COLLISION_GROUP

SAMPLES = 10_000
NEAR = 0.04  # of a robot with a leg of a metre [m]
ALWAYS = 0.95  # of the configurations
Pair = tuple[str, str]


class Collisions:
    """A robot's collision shapes, each pair of links tried, whatever the simulation lets pass.

    Attributes:
        model: the robot with the shapes that its URDF says collide.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self._near = NEAR * robot.tables.size.leg
        spec = robot_spec(robot, "all")
        self.excluded: set[Pair] = {_pair(each.bodyname1, each.bodyname2) for each in spec.excludes}
        for each in [*spec.excludes, *spec.pairs]:
            spec.delete(each)
        for geom in list(spec.geoms):
            if geom.group != COLLISION_GROUP:
                spec.delete(geom)
                continue
            geom.contype = geom.conaffinity = 1
            geom.margin, geom.gap = self._near, 0.0
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_FILTERPARENT
        self.robot = robot
        self.model = Model(robot, compiled(robot, spec))
        self._data = mujoco.MjData(self.model.mj)
        mj = self.model.mj
        self._names = [mj.body(i).name for i in range(mj.nbody)]
        self.links = [mj.body(i).name for i in range(1, mj.nbody) if mj.body_geomnum[i]]

    def touching(self, angles: FloatArray) -> set[Pair]:
        """Pairs of links that overlap.

        Args:
            angles: (n,) of the robot's joints [rad].
        """
        return self.tried(angles)[0]

    def tried(self, angles: FloatArray) -> tuple[set[Pair], set[Pair]]:
        """Pairs of links that overlap, and those that do or come near.

        Args:
            angles: (n,) of the robot's joints [rad].
        """
        mj, data = self.model.mj, self._data
        data.qpos[:] = mj.qpos0
        data.qpos[self.model.qpos] = angles[self.model.joint_indices]
        mujoco.mj_kinematics(mj, data)
        mujoco.mj_collision(mj, data)
        contact = data.contact
        near = contact.dist < self._near
        return self._pairs(contact.geom[contact.dist < 0.0]), self._pairs(contact.geom[near])

    def _pairs(self, geoms: npt.NDArray[np.int32]) -> set[Pair]:
        """Of (k, 2) geoms the links."""
        bodies = self.model.mj.geom_bodyid[geoms].reshape(-1, 2).tolist()
        return {_pair(self._names[one], self._names[other]) for one, other in set(map(tuple, bodies))}

    def neighbours(self) -> set[Pair]:
        """Links that are fixed to each other, or have one joint between them, or links without shapes."""
        mj = self.model.mj
        shaped = [i for i in range(1, mj.nbody) if mj.body_geomnum[i]]
        found = {(one, other) for one, other in combinations(shaped, 2) if mj.body_weldid[one] == mj.body_weldid[other]}
        for body in shaped:
            found |= {(body, other) for other in self._beyond(body, {body})}
        return {_pair(mj.body(one).name, mj.body(other).name) for one, other in found}

    def _beyond(self, body: int, seen: set[int]) -> Iterator[int]:
        """Links with shapes to which no other with a shape is in the way."""
        mj = self.model.mj
        children = [i for i in range(1, mj.nbody) if mj.body_parentid[i] == body]
        for other in (int(mj.body_parentid[body]), *children):
            if not other or other in seen:
                continue
            seen.add(other)
            if mj.body_geomnum[other]:
                yield other
            else:
                yield from self._beyond(other, seen)


def disabled_collisions(collisions: Collisions, samples: int = SAMPLES, seed: int = 0) -> dict[Pair, str]:
    """Pairs of links → why a planner need not look at them, in the assistant's words.

    Args:
        collisions: the robot's shapes.
        samples: random configurations.
        seed: of them.
    """
    robot = collisions.robot
    reasons = dict.fromkeys(sorted(collisions.neighbours()), "Adjacent")
    for angles in named_postures(robot):
        for pair in sorted(collisions.touching(angles)):
            reasons.setdefault(pair, "Default")
    lower = np.where(np.isfinite(robot.lower), robot.lower, -np.pi)
    upper = np.where(np.isfinite(robot.upper), robot.upper, np.pi)
    generator, times = np.random.default_rng(seed), Counter[Pair]()
    kept = {_pair(*each) for each in robot.tables.self_collision.pairs}
    for _ in range(samples):
        # Arcsine's distribution: limbs reach across the body with their joints near the limits.
        touching, near = collisions.tried(lower + (upper - lower) * generator.beta(0.5, 0.5, len(lower)))
        times.update(touching)
        kept |= near
    for one, other in combinations(collisions.links, 2):
        pair = _pair(one, other)
        if pair in collisions.excluded:
            reasons.setdefault(pair, "User")
        elif times[pair] >= ALWAYS * samples:
            reasons.setdefault(pair, "Always")
        elif pair not in kept:
            reasons.setdefault(pair, "Never")
    return dict(sorted(reasons.items()))


def named_postures(robot: RobotDescription) -> Iterator[FloatArray]:
    """(n,) the configuration of zeros, or as near as joints go; the nominal one; it with each side's presets [rad]."""
    yield np.clip(np.zeros(len(robot.joints)), robot.lower, robot.upper)
    yield robot.nominal_posture
    for presets in (robot.tables.arm_presets, robot.tables.hand_presets):
        for sides in presets.values():
            for joints in sides.values():
                yield posture(robot, joints)


def posture(robot: RobotDescription, joints: Mapping[str, float]) -> FloatArray:
    """(n,) the nominal one but for some joints [rad]."""
    angles = robot.nominal_posture.copy()
    for name, angle in joints.items():
        angles[robot.index[name]] = angle
    return angles


def _pair(one: str, other: str) -> Pair:
    return (one, other) if one < other else (other, one)
