"""A robot in the scene: a tree of frames with a mesh a color, of which only what has moved is sent."""

from __future__ import annotations

import numpy as np
from viser import FrameHandle, SceneApi

from valor.common.arrays import FloatArray
from valor.operator_station import shapes
from valor.operator_station.body import Body

_STILL = (2e-4, 2e-4)  # less than this is not sent [m, 1]

Color = tuple[int, int, int]


class Figure:
    """One robot, as it is or as it would be."""

    def __init__(
        self, scene: SceneApi, name: str, body: Body, *, color: Color | None = None, opacity: float | None = None
    ) -> None:
        """Add it to the scene.

        Args:
            scene: of the page.
            name: of its node.
            body: in whose posture it is drawn.
            color: of all of it, for a ghost; None: the robot's own.
            opacity: for a ghost.
        """
        model = body.model.mj
        self._root = scene.add_frame(f"/{name}", show_axes=False)
        self._parents = np.array(model.body_parentid)
        paths = {0: f"/{name}"}
        self._frames: list[FrameHandle] = []
        for number in range(1, model.nbody):
            paths[number] = f"{paths[int(self._parents[number])]}/{model.body(number).name}"
            self._frames.append(scene.add_frame(paths[number], show_axes=False))
            for place, mesh in enumerate(shapes.of_body(model, number)):
                scene.add_mesh_simple(
                    f"{paths[number]}/mesh{place}",
                    mesh.vertices.astype(np.float32),
                    mesh.faces,
                    color=color or mesh.color,
                    opacity=opacity,
                    flat_shading=True,
                    cast_shadow=color is None,
                    receive_shadow=False,
                )
        self.paths = paths
        self._positions = np.full((model.nbody - 1, 3), np.nan)
        self._orientations = np.full((model.nbody - 1, 4), np.nan)

    def show(self, visible: bool) -> None:
        """Or hide it."""
        if self._root.visible != visible:
            self._root.visible = visible

    @property
    def visible(self) -> bool:
        """Whether it is shown."""
        return bool(self._root.visible)

    def draw(self, body: Body) -> int:
        """Bring it into a posture; how many frames had moved."""
        position, orientation = local_poses(body, self._parents)
        moved = (np.abs(position - self._positions).max(axis=1) <= _STILL[0]) & (
            np.abs(orientation - self._orientations).max(axis=1) <= _STILL[1]
        )
        changed = np.flatnonzero(~moved)
        for place in changed.tolist():
            frame = self._frames[place]
            if not np.abs(position[place] - self._positions[place]).max() <= _STILL[0]:
                frame.position = position[place]
            if not np.abs(orientation[place] - self._orientations[place]).max() <= _STILL[1]:
                frame.wxyz = orientation[place]
        self._positions[changed] = position[changed]
        self._orientations[changed] = orientation[changed]
        return len(changed)


def local_poses(body: Body, parents: np.ndarray[tuple[int], np.dtype[np.int32]]) -> tuple[FloatArray, FloatArray]:
    """(b, 3) and (b, 4) of all bodies but the world, each in its parent."""
    data = body.data
    mother = parents[1:]
    w, x, y, z = data.xquat[mother].T * np.array([[1.0], [-1.0], [-1.0], [-1.0]])
    a, b, c, d = data.xquat[1:].T
    orientation = np.column_stack((
        w * a - x * b - y * c - z * d,
        w * b + x * a + y * d - z * c,
        w * c - x * d + y * a + z * b,
        w * d + x * c - y * b + z * a,
    ))  # fmt: skip
    turns = data.xmat[mother].reshape(-1, 3, 3)
    position = np.einsum("bji,bj->bi", turns, data.xpos[1:] - data.xpos[mother])
    return position, orientation
