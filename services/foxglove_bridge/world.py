"""Scene entities of the simulated world, from its name and seed: ground and moving fixtures."""

from collections.abc import Iterable
from typing import Any

import mujoco
import numpy as np
from foxglove.messages import CubePrimitive, CylinderPrimitive, SceneEntity, TriangleListPrimitive

from valor.common.arrays import FloatArray
from valor.common.instance import Settings
from valor.foxglove_bridge.shapes import color, points, pose, size
from valor.robot.description import RobotDescription
from valor.simulation import worlds
from valor.simulation.height_fields import triangles

_FLOOR = 30.0  # side of the box drawn for an infinite floor [m]
_THICK = 0.01  # its thickness [m]
_FLOOR_COLOR = "d3d7db"
_FINE = 0.1  # largest spacing of drawn points of a height field [m]


class World:
    """Shapes of a world."""

    def __init__(self, settings: Settings, robot: RobotDescription) -> None:
        """Load the world of the settings, scaled to the robot. Raises ConfigurationError: the world does not exist."""
        self._model = worlds.load(settings.world, settings.seed, worlds.size_of(robot)).compile()
        self._data = mujoco.MjData(self._model)
        mujoco.mj_kinematics(self._model, self._data)
        self._fixed = self._model.body_weldid[self._model.geom_bodyid] == 0

    def ground(self, frame: str) -> SceneEntity:
        """Return the fixed shapes, in the frame with the robot's start above its origin."""
        return self._entity("world", frame, np.flatnonzero(self._fixed))

    def fixtures(self, frame: str, positions: FloatArray) -> SceneEntity | None:
        """Return the moving shapes at positions of the world's joints [rad]; None without any, or if sizes differ."""
        if not self._model.nq or positions.size != self._model.nq:
            return None
        self._data.qpos[:] = positions
        mujoco.mj_kinematics(self._model, self._data)
        return self._entity("fixtures", frame, np.flatnonzero(~self._fixed))

    def _entity(self, name: str, frame: str, geoms: Iterable[int]) -> SceneEntity:
        model, data, turn = self._model, self._data, np.empty(4)
        cubes, cylinders, triangles = [], [], []
        for geom in geoms:
            kind, half = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
            mujoco.mju_mat2Quat(turn, data.geom_xmat[geom])
            where = pose(data.geom_xpos[geom], turn.tolist())
            if kind == mujoco.mjtGeom.mjGEOM_PLANE:
                x, y, z = model.geom_pos[geom]
                below = pose((x, y, z - _THICK / 2))
                cubes.append(CubePrimitive(pose=below, size=size(_FLOOR, _FLOOR, _THICK), color=color(_FLOOR_COLOR)))
            elif kind == mujoco.mjtGeom.mjGEOM_BOX:
                cubes.append(CubePrimitive(pose=where, size=size(*(2.0 * half)), color=_color(model, geom)))
            elif kind in (mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_CAPSULE):
                extent, tint = size(2.0 * half[0], 2.0 * half[0], 2.0 * half[1]), _color(model, geom)
                cylinders.append(
                    CylinderPrimitive(pose=where, size=extent, bottom_scale=1.0, top_scale=1.0, color=tint)
                )
            elif kind == mujoco.mjtGeom.mjGEOM_HFIELD:
                triangles.append(_height_field(model, geom))
        return SceneEntity(frame_id=frame, id=name, cubes=cubes, cylinders=cylinders, triangles=triangles)


def _color(model: Any, geom: int) -> Any:
    material = int(model.geom_matid[geom])
    plain = bool((model.geom_rgba[geom] == [0.5, 0.5, 0.5, 1.0]).all())  # MuJoCo's default
    rgba = model.mat_rgba[material] if material >= 0 and plain else model.geom_rgba[geom]
    return color("".join(f"{round(255 * float(each)):02x}" for each in rgba[:3]))


def _height_field(model: Any, geom: int) -> TriangleListPrimitive:
    """Return a height field, coarser than simulated."""
    vertices, faces = triangles(model, int(model.geom_dataid[geom]), _FINE)
    where = pose(model.geom_pos[geom], model.geom_quat[geom])
    return TriangleListPrimitive(
        pose=where, points=points(vertices), color=_color(model, geom), indices=faces.ravel().tolist()
    )
