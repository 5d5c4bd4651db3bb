"""Triangle meshes of MuJoCo's shapes, one per color."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
import trimesh

from valor.common.arrays import FloatArray
from valor.simulation.height_fields import triangles

_GEOM = mujoco.mjtGeom


@dataclass(frozen=True)
class Mesh:
    """(v, 3) vertices [m], (f, 3) faces, and the color 0 to 255."""

    vertices: FloatArray
    faces: np.ndarray[tuple[int, ...], np.dtype[np.uint32]]
    color: tuple[int, int, int]


def of_body(model: mujoco.MjModel, body: int) -> list[Mesh]:
    """Return the visible shapes of a body in its frame."""
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    return _merged(_geoms(model, range(first, first + count)))


def of_world(model: mujoco.MjModel) -> list[Mesh]:
    """Return all fixed shapes but planes in the world's frame."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    parts = []
    for geom in np.flatnonzero(model.body_weldid[model.geom_bodyid] == 0).tolist():
        if (made := _shape(model, geom)) is not None:
            vertices, faces = made
            turn = data.geom_xmat[geom].reshape(3, 3)
            parts.append((vertices @ turn.T + data.geom_xpos[geom], faces, _color(model, geom)))
    return _merged(parts)


Part = tuple[FloatArray, FloatArray, tuple[int, int, int]]


def _geoms(model: mujoco.MjModel, geoms: Iterable[int]) -> Iterator[Part]:
    for geom in geoms:
        if model.geom_group[geom] > 2 or _rgba(model, geom)[3] == 0.0:  # as MuJoCo's own viewer hides them
            continue
        if (made := _shape(model, geom)) is not None:
            vertices, faces = made
            turn = np.zeros(9)
            mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
            yield vertices @ turn.reshape(3, 3).T + model.geom_pos[geom], faces, _color(model, geom)


def _merged(parts: Iterable[Part]) -> list[Mesh]:
    by_color: dict[tuple[int, int, int], list[Part]] = {}
    for part in parts:
        by_color.setdefault(part[2], []).append(part)
    meshes = []
    for color, same in by_color.items():
        starts = np.cumsum([0, *(len(vertices) for vertices, _, _ in same)])
        faces = np.concatenate([faces + start for (_, faces, _), start in zip(same, starts, strict=False)])
        meshes.append(Mesh(np.concatenate([vertices for vertices, _, _ in same]), faces.astype(np.uint32), color))
    return meshes


def _shape(model: mujoco.MjModel, geom: int) -> tuple[FloatArray, FloatArray] | None:
    kind, size = model.geom_type[geom], model.geom_size[geom]
    if kind == _GEOM.mjGEOM_MESH:
        return _mesh(model, int(model.geom_dataid[geom]))
    if kind == _GEOM.mjGEOM_HFIELD:
        return triangles(model, int(model.geom_dataid[geom]))
    if kind == _GEOM.mjGEOM_BOX:
        made = trimesh.creation.box(extents=2.0 * size)
    elif kind == _GEOM.mjGEOM_SPHERE:
        made = trimesh.creation.icosphere(subdivisions=2, radius=size[0])
    elif kind == _GEOM.mjGEOM_ELLIPSOID:
        made = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
        made.apply_scale(size)
    elif kind == _GEOM.mjGEOM_CYLINDER:
        made = trimesh.creation.cylinder(radius=size[0], height=2.0 * size[1], sections=20)
    elif kind == _GEOM.mjGEOM_CAPSULE:
        made = trimesh.creation.capsule(radius=size[0], height=2.0 * size[1], count=[12, 12])
        made.vertices -= made.bounds.mean(axis=0)
    else:
        return None
    return np.asarray(made.vertices, dtype=float), np.asarray(made.faces)


def _mesh(model: mujoco.MjModel, mesh: int) -> tuple[FloatArray, FloatArray]:
    vertex, face = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
    vertices = model.mesh_vert[vertex : vertex + int(model.mesh_vertnum[mesh])]
    faces = model.mesh_face[face : face + int(model.mesh_facenum[mesh])]
    return np.array(vertices, dtype=float), np.array(faces)


def _rgba(model: mujoco.MjModel, geom: int) -> FloatArray:
    material = int(model.geom_matid[geom])
    rgba: FloatArray = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    return rgba


def _color(model: mujoco.MjModel, geom: int) -> tuple[int, int, int]:
    red, green, blue = (round(255.0 * float(part)) for part in _rgba(model, geom)[:3])
    return red, green, blue
