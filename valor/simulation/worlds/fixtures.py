"""Fixtures to move: a door with a lever handle and a latch, and a valve's wheel in front of a wall."""

import math
from dataclasses import dataclass
from itertools import pairwise

import mujoco
import numpy as np

from valor.common.poses import Pose, level
from valor.simulation.worlds.world import EDGE, MARK, STONE, Spread, World, decoration, floor, moving

_BOX, _CAPSULE = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CAPSULE
_LATCH_BIT = 8  # of contype and conaffinity: bolt and strike touch only each other
_STIFF = (0.005, 1.0)  # contact of bolt and strike
_HEIGHT, _THICK, _JAMB = 2.03, 0.04, 0.10  # of the leaf; width of the frame [m]
_EDGE = 0.05  # from the spindle to the leaf's free edge [m]
_BAR = 0.008  # radius of the lever [m]
_BOLT = (0.057, 0.075)  # from the spindle: where the bolt is in the strike [m]
_THIN = 0.005  # half of the bolt's height [m]


@dataclass(frozen=True)
class Door(World):
    """A door that opens away from the robot, with its handle on the robot's right, at a random location.

    Its frame is on the floor below the spindle, in the plane of the leaf's near face: x points through the door, y to
    the hinge. The lever points along y, and is pressed down against a spring. The bolt rotates with it about the
    spindle, and is out of the strike at ``unlatch``::

              │ lever ═══╗ spindle │▒ strike      seen from the robot
              │          ╚═════════│══ bolt
        hinge │        leaf        │▒
    """

    start: Spread
    handle_height: float = 0.95  # of the spindle [m]
    lever: float = 0.07  # length, from the spindle [m]
    out: float = 0.03  # from the leaf's face to the lever's axis [m]
    hinge: float = 0.82  # from spindle to hinge [m]
    mass: float = 18.0  # of the leaf [kg]
    friction: float = 1.5  # of the hinge [N·m]
    closer: float = 3.0  # damping of the hinge [N·m·s/rad]
    spring: tuple[float, float] = (0.25, 0.8)  # of the lever: torque at rest [N·m], stiffness [N·m/rad]
    unlatch: float = math.radians(30.0)
    farthest: float = math.radians(60.0)  # of the lever

    def pose(self, rng: np.random.Generator) -> Pose:
        """Draw its frame."""
        return self.start.draw(rng)

    def add_to(self, spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
        """Add floor, frame, leaf and lever."""
        floor(spec)
        pose = self.pose(rng)
        self._add_frame(spec, pose)
        leaf = moving(
            spec.worldbody, "leaf", pose @ level(0.0, self.hinge, 0.0, 0.0), axis=(0, 0, 1), reach=math.radians(110.0)
        )
        joint = leaf.first_joint()
        joint.damping[0], joint.frictionloss = self.closer, self.friction
        width = self.hinge + _EDGE
        leaf.add_geom(
            type=_BOX,
            pos=[_THICK / 2, -width / 2, _HEIGHT / 2 + 0.01],
            size=[_THICK / 2, width / 2, _HEIGHT / 2],
            mass=self.mass,
            rgba=[0.62, 0.50, 0.36, 1.0],
            contype=1,
            conaffinity=0,
        )
        self._add_lever(leaf)

    def _add_lever(self, leaf: mujoco.MjsBody) -> None:
        at = level(0.0, -self.hinge, self.handle_height, 0.0)
        lever = moving(leaf, "lever", at, axis=(-1, 0, 0), reach=self.farthest)
        joint = lever.first_joint()
        rest, rate = self.spring
        joint.stiffness[0], joint.springref, joint.damping[0] = rate, -rest / rate, 0.02
        joint.armature = 1e-3
        near = {"contype": 1, "conaffinity": 0, "material": EDGE, "type": _CAPSULE}
        lever.add_geom(fromto=[0, 0, 0, -self.out, 0, 0], size=[_BAR, 0, 0], mass=0.05, **near)
        lever.add_geom(fromto=[-self.out, 0, 0, -self.out, self.lever - _BAR, 0], size=[_BAR, 0, 0], mass=0.1, **near)
        first, last = 0.02, _BOLT[1]
        lever.add_geom(
            name="bolt",
            type=_BOX,
            pos=[_THICK / 2, -(first + last) / 2, 0],
            size=[_THIN, (last - first) / 2, _THIN],
            mass=0.05,
            contype=_LATCH_BIT,
            conaffinity=_LATCH_BIT,
            condim=1,
            solref=_STIFF,
            material=EDGE,
        )

    def _add_frame(self, spec: mujoco.MjSpec, pose: Pose) -> None:
        """Add jambs, lintel, walls, and the strike, which holds the bolt."""
        right, left = -_EDGE - 0.005, self.hinge + 0.005
        top, wall = _HEIGHT + 0.02, 0.5
        posts = (
            (right - _JAMB / 2, _JAMB / 2, top / 2, top / 2, MARK),
            (left + _JAMB / 2, _JAMB / 2, top / 2, top / 2, MARK),
            ((left + right) / 2, (left - right) / 2 + _JAMB, top + _JAMB / 2, _JAMB / 2, MARK),
            (right - _JAMB - wall / 2, wall / 2, (top + _JAMB) / 2, (top + _JAMB) / 2, STONE),
            (left + _JAMB + wall / 2, wall / 2, (top + _JAMB) / 2, (top + _JAMB) / 2, STONE),
        )
        for y, half_width, z, half_height, material in posts:
            place = pose @ Pose((_THICK / 2 + 0.01, y, z))
            spec.worldbody.add_geom(
                type=_BOX,
                pos=place.position,
                quat=place.orientation,
                size=[_THICK / 2 + 0.01, half_width, half_height],
                material=material,
                contype=1,
                conaffinity=0,
            )
        # The bolt, rotated by ``unlatch``, has just left it.
        top = _BOLT[0] * math.sin(self.unlatch) - _THIN * math.cos(self.unlatch)
        low = -0.03
        place = pose @ Pose((_THICK / 2 + _THIN + 0.011, right - _JAMB / 2, self.handle_height + (top + low) / 2))
        strike = decoration(
            spec, name="strike", type=_BOX, pos=place.position, quat=place.orientation,
            size=[0.01, _JAMB / 2, (top - low) / 2], material=EDGE,
        )  # fmt: skip
        strike.contype = strike.conaffinity = _LATCH_BIT
        strike.condim, strike.solref[:2] = 1, _STIFF


_PIECES = 24  # of the rim
_TUBE, _SPOKE = 0.013, 0.009  # radii [m]


@dataclass(frozen=True)
class Valve(World):
    """A wheel with spokes and a level axis, at a random location and angle.

    Its frame is on the floor below the wheel's center, in the wheel's plane: x points away from the robot, to the wall.
    """

    start: Spread
    height: float = 1.0  # of the axis [m]
    radius: float = 0.2  # [m]
    spokes: int = 3
    wall: float = 0.22  # behind the wheel's plane [m]
    friction: float = 2.0  # [N·m]
    damping: float = 0.5  # [N·m·s/rad]

    def pose(self, rng: np.random.Generator) -> Pose:
        """Draw its frame."""
        return self.start.draw(rng)

    def spoke(self, rng: np.random.Generator) -> float:
        """Draw the initial angle of the first spoke about x from y, after ``pose`` [rad]."""
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
