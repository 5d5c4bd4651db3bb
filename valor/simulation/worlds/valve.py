"""A valve's wheel before a wall, and a way to it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Self

import mujoco
import numpy as np

from valor.common.poses import Pose
from valor.simulation.worlds.world import EDGE, MARK, STONE, Spread, floor, moving

_BOX, _CAPSULE = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CAPSULE
_PIECES = 24  # of the rim
_TUBE, _SPOKE = 0.013, 0.009  # radii [m]


@dataclass(frozen=True)
class Valve:
    """A wheel with spokes, its axis level; where it stands is random, and how it is turned.

    Its frame is on the floor below the wheel's middle, in the wheel's plane: x points away from the robot, to the wall.
    """

    start: Spread
    height: float = 1.0  # of the axis [m]
    radius: float = 0.2  # [m]
    spokes: int = 3
    wall: float = 0.22  # behind the wheel's plane [m]
    friction: float = 2.0  # [N·m]
    damping: float = 0.5  # [N·m·s/rad]

    def sized(self, size: float) -> Self:
        """The same for all."""
        return self

    def pose(self, rng: np.random.Generator) -> Pose:
        """Where its frame is."""
        return self.start.draw(rng)

    def spoke(self, rng: np.random.Generator) -> float:
        """How the first spoke is turned about x from y, at first; after ``pose`` [rad]."""
        return float(rng.uniform(0.0, math.tau / self.spokes))

    def add_to(self, spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
        """Add floor, wall and wheel."""
        floor(spec)
        pose = self.pose(rng)
        first = self.spoke(rng)
        behind = pose @ Pose((self.wall + 0.05, 0.0, 1.0))
        solid = {"contype": 1, "conaffinity": 0}
        spec.worldbody.add_geom(
            type=_BOX, pos=behind.position, quat=behind.orientation, size=[0.05, 0.8, 1.0], material=STONE, **solid
        )
        turned = Pose((0.0, 0.0, self.height), (math.cos(first / 2), math.sin(first / 2), 0.0, 0.0))
        wheel = moving(spec.worldbody, "wheel", pose @ turned, axis=(1, 0, 0))
        joint = wheel.first_joint()
        joint.damping[0], joint.frictionloss, joint.armature = self.damping, self.friction, 0.01
        corners = [math.tau * i / _PIECES for i in range(_PIECES + 1)]
        points = [(0.0, self.radius * math.cos(a), self.radius * math.sin(a)) for a in corners]
        for one, other in pairwise(points):
            wheel.add_geom(type=_CAPSULE, fromto=[*one, *other], size=[_TUBE, 0, 0], mass=0.05, material=MARK, **solid)
        for i in range(self.spokes):
            angle = math.tau * i / self.spokes
            end = [0.0, self.radius * math.cos(angle), self.radius * math.sin(angle)]
            wheel.add_geom(type=_CAPSULE, fromto=[0, 0, 0, *end], size=[_SPOKE, 0, 0], mass=0.2, material=MARK, **solid)
        wheel.add_geom(
            type=_CAPSULE, fromto=[0, 0, 0, self.wall, 0, 0], size=[0.02, 0, 0], mass=0.5, material=EDGE, **solid
        )
