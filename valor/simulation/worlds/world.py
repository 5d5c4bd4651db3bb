"""Base class of worlds, the level floor, materials and common geoms."""

from dataclasses import dataclass
from typing import Any, Self

import mujoco
import numpy as np

from valor.common.poses import Pose, level

FRICTION = 0.9
"""Friction coefficient of all ground."""

FLOOR, DIRT, STONE, EDGE, MARK = "floor", "dirt", "stone", "edge", "mark"
"""Materials."""


class World:
    """A generator of ground; itself a level floor at z = 0."""

    def sized(self, size: float) -> Self:
        """Scale unseen obstacles, if any; ``size``: leg length relative to ESCHER's."""
        return self

    def add_to(self, spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
        """Add its geoms to the world body."""
        floor(spec)


@dataclass(frozen=True)
class Spread:
    """Range of a fixture's random pose: x and y [m], and yaw to either side [rad]."""

    x: tuple[float, float]
    y: tuple[float, float]
    yaw: float

    def draw(self, rng: np.random.Generator) -> Pose:
        """Draw a frame on the floor."""
        x, y, yaw = map(float, rng.uniform((self.x[0], self.y[0], -self.yaw), (self.x[1], self.y[1], self.yaw)))
        return level(x, y, 0.0, yaw)


def add_materials(spec: mujoco.MjSpec) -> None:
    """Add the materials, and the texture of the floor: squares of half a metre."""
    spec.add_texture(
        name="squares",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        mark=mujoco.mjtMark.mjMARK_EDGE,
        rgb1=[0.80, 0.82, 0.84],
        rgb2=[0.80, 0.82, 0.84],
        markrgb=[0.66, 0.69, 0.72],
        width=512,
        height=512,
    )
    floor = spec.add_material(name=FLOOR, texrepeat=[2, 2], texuniform=True)
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "squares"
    spec.add_material(name=DIRT, rgba=[0.60, 0.50, 0.40, 1.0], specular=0.05)
    spec.add_material(name=STONE, rgba=[0.66, 0.68, 0.70, 1.0], specular=0.1)
    spec.add_material(name=EDGE, rgba=[0.87, 0.66, 0.20, 1.0])
    spec.add_material(name=MARK, rgba=[0.80, 0.30, 0.20, 1.0])


def ground(spec: mujoco.MjSpec, **geom: Any) -> mujoco.MjsGeom:
    """Add a geom that the robot touches."""
    made = spec.worldbody.add_geom(contype=1, conaffinity=0, condim=3, **geom)
    made.friction[0] = FRICTION
    return made


def decoration(spec: mujoco.MjSpec, **geom: Any) -> mujoco.MjsGeom:
    """Add a geom without contacts."""
    return spec.worldbody.add_geom(contype=0, conaffinity=0, **geom)


def moving(
    parent: mujoco.MjsBody, name: str, pose: Pose, axis: tuple[float, float, float], reach: float | None = None
) -> mujoco.MjsBody:
    """Add a body on a hinge at its origin, of the same name, with range 0 to ``reach`` [rad]; None: no limit."""
    body = parent.add_body(name=name, pos=pose.position, quat=pose.orientation)
    joint = body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis)
    if reach is not None:
        joint.limited, joint.range = mujoco.mjtLimited.mjLIMITED_TRUE, (0.0, reach)
    return body


def floor(spec: mujoco.MjSpec, height: float = 0.0) -> None:
    """Add an infinite level floor at a height [m]."""
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    ground(spec, name="floor", type=plane, size=[0, 0, 0.05], pos=[0, 0, height], material=FLOOR)


def block(
    spec: mujoco.MjSpec, x: tuple[float, float], y: tuple[float, float], top: float, material: str, **geom: Any
) -> None:
    """Add a box that stands on z = 0, its extent along x and y and its top [m]."""
    centre = [(x[0] + x[1]) / 2, (y[0] + y[1]) / 2, top / 2]
    half = [(x[1] - x[0]) / 2, (y[1] - y[0]) / 2, top / 2]
    ground(spec, type=mujoco.mjtGeom.mjGEOM_BOX, pos=centre, size=half, material=material, **geom)
