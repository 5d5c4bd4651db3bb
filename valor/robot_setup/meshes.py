"""What one sees of a robot: its meshes, made coarser until they are no burden, as STL."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray

FACES = 120_000  # of a robot, at most: 6 MB
_CELL = 0.003  # of a robot with a leg of a metre: what lies so near becomes one vertex [m]
_COARSER = 1.5  # a cell, if there are still too many faces
_FEW = 300  # faces that are not worth the trouble

Faces = npt.NDArray[np.int32]
Triangles = tuple[FloatArray, Faces]


def write(mj: mujoco.MjModel, names: Mapping[int, str], folder: Path, size: float) -> None:
    """Write meshes into a folder.

    Args:
        mj: the model.
        names: mesh → file, without ".stl".
        folder: made if there is something to write.
        size: of the robot, as its leg is long [m].
    """
    drawn = {mesh: _triangles(mj, mesh) for mesh in names}
    coarse, cell = drawn, _CELL * size
    while sum(len(faces) for _, faces in coarse.values()) > FACES:
        coarse = {mesh: coarser(*drawn[mesh], cell) for mesh in names}
        cell *= _COARSER
    for mesh, (vertices, faces) in coarse.items():
        folder.mkdir(exist_ok=True)
        triangles = np.zeros(len(faces), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
        triangles["corners"] = vertices[faces]
        with (folder / f"{names[mesh]}.stl").open("wb") as file:
            file.write(b"\0" * 80 + np.uint32(len(faces)).tobytes() + triangles.tobytes())


def coarser(vertices: FloatArray, faces: Faces, cell: float) -> Triangles:
    """A mesh with one vertex a cell of a grid, in the middle of those that were there, and no face twice.

    Rossignac and Borrel, 1993. What would hardly be left of comes back as it is.

    Args:
        vertices: (k, 3) [m].
        faces: (m, 3) of vertices.
        cell: of the grid [m].
    """
    if len(faces) <= _FEW:
        return vertices, faces
    _, place = np.unique(np.floor(vertices / cell).astype(np.int64), axis=0, return_inverse=True)
    place = place.reshape(-1)
    count = np.bincount(place)
    middle = np.stack([np.bincount(place, vertices[:, axis]) / count for axis in range(3)], axis=1)
    kept = place[faces]
    kept = kept[(kept[:, 0] != kept[:, 1]) & (kept[:, 1] != kept[:, 2]) & (kept[:, 2] != kept[:, 0])]
    if not len(kept):
        return vertices, faces
    _, first = np.unique(np.sort(kept, axis=1), axis=0, return_index=True)
    kept = kept[np.sort(first)].astype(np.int32)
    return (middle, kept) if len(np.unique(kept)) >= 12 else (vertices, faces)


def _triangles(mj: mujoco.MjModel, mesh: int) -> Triangles:
    vertices = mj.mesh_vert[mj.mesh_vertadr[mesh] : mj.mesh_vertadr[mesh] + mj.mesh_vertnum[mesh]]
    faces = mj.mesh_face[mj.mesh_faceadr[mesh] : mj.mesh_faceadr[mesh] + mj.mesh_facenum[mesh]]
    return np.asarray(vertices, dtype=np.float64), np.asarray(faces)
