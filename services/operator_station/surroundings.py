"""The simulated world on the page: where the robot began, and what turns in it as far as it is turned."""

from __future__ import annotations

import mujoco
import numpy as np
from viser import SceneApi

from valor.common.arrays import FloatArray
from valor.operator_station import shapes

LEAST = 1e-3  # that a joint turns until it is drawn anew [rad]


class Surroundings:
    """A world's shapes. odom and world agree where the robot began, and drift apart as odometry does.

    Attributes:
        frames: of the bodies that turn, by their numbers.
    """

    def __init__(self, scene: SceneApi, model: mujoco.MjModel) -> None:
        """Draw it, shut."""
        self._model, self._data = model, mujoco.MjData(model)
        mujoco.mj_kinematics(model, self._data)
        self._drawn = np.zeros(model.nq)
        for place, mesh in enumerate(shapes.of_world(model)):
            _add(scene, f"/world/{place}", mesh)
        self.frames = {}
        for body in moving(model):
            name = f"/world/body_{body}"
            self.frames[body] = scene.add_frame(name, show_axes=False)
            for place, mesh in enumerate(shapes.of_body(model, body)):
                _add(scene, f"{name}/{place}", mesh)
        self._place()

    def turn(self, positions: FloatArray) -> None:
        """Its joints stand so [rad], in the world's order; others than it has are of another world."""
        if positions.size == self._drawn.size and np.abs(positions - self._drawn).max(initial=0.0) >= LEAST:
            self._drawn = positions.copy()
            self._data.qpos[:] = positions
            mujoco.mj_kinematics(self._model, self._data)
            self._place()

    def _place(self) -> None:
        for body, frame in self.frames.items():
            frame.position, frame.wxyz = self._data.xpos[body].copy(), self._data.xquat[body].copy()


def moving(model: mujoco.MjModel) -> list[int]:
    """The bodies of a world that are not fixed to it."""
    return [int(body) for body in np.flatnonzero(model.body_weldid)]


def _add(scene: SceneApi, name: str, mesh: shapes.Mesh) -> None:
    scene.add_mesh_simple(
        name, mesh.vertices.astype(np.float32), mesh.faces, color=mesh.color, flat_shading=True,
        cast_shadow=False, receive_shadow=False,
    )  # fmt: skip
