"""Points on the shapes of a model's bodies, and what is fitted to them: soles and capsules."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from valor.common.arrays import FloatArray
from valor.robot_setup.source import Source

_TOUCHING = 0.015  # of a foot's length: points so near its lowest plane are on it
_LEVEL = 0.85  # cosine between the underside's normal and the vertical, as drawn, at least
_SAME = 0.997  # cosine between the normals of facets that are one plane
_ROUND = 12  # points around a circle


@dataclass(frozen=True)
class Sole:
    """A rectangle on the underside of a foot, in the world as drawn.

    Attributes:
        origin: (3,) below the ankle [m].
        rotation: (3, 3) its axes: forward, left, up.
        heel, toe: its back and front edges' x [m].
        half_width: [m].
    """

    origin: FloatArray
    rotation: FloatArray
    heel: float
    toe: float
    half_width: float


@dataclass(frozen=True)
class Capsule:
    """Two ends in a body's frame, and a radius [m]."""

    start: FloatArray
    end: FloatArray
    radius: float


def touching_geoms(source: Source, bodies: Iterable[int]) -> list[int]:
    """Geoms of bodies that collide; all that there are, where none does."""
    mj = source.mj
    mine = [g for b in bodies for g in range(mj.body_geomadr[b], mj.body_geomadr[b] + mj.body_geomnum[b])]
    return [g for g in mine if mj.geom_contype[g] or mj.geom_conaffinity[g]] or mine


def surface(source: Source, geom: int) -> FloatArray:
    """(k, 3) points on a geom in the world as drawn [m]: vertices, corners, and the ends of what is round."""
    mj, data = source.mj, source.data
    size = mj.geom_size[geom]
    angle = np.linspace(0.0, 2 * np.pi, _ROUND, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    # Of what is round, the points farthest along the world's axes: the lowest one is where it touches the ground.
    ball = np.concatenate([np.eye(3), -np.eye(3)]) @ data.geom_xmat[geom].reshape(3, 3)
    kind = mj.geom_type[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(mj.geom_dataid[geom])
        first, count = mj.mesh_vertadr[mesh], mj.mesh_vertnum[mesh]
        points = np.asarray(mj.mesh_vert[first : first + count], dtype=np.float64)
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        points = size[0] * ball
    elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        points = size * ball
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        points = np.concatenate([size[0] * ball + [0, 0, end * size[1]] for end in (-1, 1)])
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        points = np.concatenate([size[0] * circle + [0, 0, end * size[1]] for end in (-1, 1)])
    else:
        points = (
            mj.geom_aabb[geom, :3] + np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T * mj.geom_aabb[geom, 3:]
        )
    return np.asarray(data.geom_xpos[geom] + points @ data.geom_xmat[geom].reshape(3, 3).T)


def cloud(source: Source, bodies: Iterable[int]) -> FloatArray:
    """(k, 3) points on all that collides of some bodies, in the world as drawn [m]."""
    points = [surface(source, geom) for geom in touching_geoms(source, bodies)]
    return np.concatenate(points) if points else np.zeros((0, 3))


def sole(points: FloatArray, ankle: FloatArray, axes: FloatArray) -> Sole | None:
    """The largest rectangle, along the foot, in the flat underside of a foot; None where it has none.

    Args:
        points: (k, 3) of the foot's surface, in the world as drawn [m].
        ankle: (3,) [m].
        axes: (3, 3) the robot's forward, left, up in the world.
    """
    if len(points) < 3:
        return None
    near = _TOUCHING * max(float(np.ptp(points @ axes[:, 0])), 0.05)
    normal = _underside(points, axes[:, 2])
    rotation = _plane(normal, axes)
    depth = points @ normal
    lowest = points[depth < depth.min() + near]
    hull = _hull(lowest @ rotation[:, :2])
    if hull is None:
        return None
    heel, toe, middle, half_width = _rectangle(hull)
    below = float(ankle @ rotation[:, 0])
    if not heel < below < toe:
        below = (heel + toe) / 2
    origin = rotation @ np.array([below, middle, float(depth.min())])
    return Sole(origin, rotation, heel - below, toe - below, half_width)


def _underside(points: FloatArray, up: FloatArray) -> FloatArray:
    """(3,) upward normal of the largest plane below a foot."""
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        return up
    normals = hull.equations[:, :3]
    corners = hull.points[hull.simplices]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    below = normals @ -up > _LEVEL
    if not below.any():
        return up
    normals, area = normals[below], area[below]
    alike = normals @ normals.T > _SAME
    largest = alike[int(np.argmax(alike @ area))]
    normal: FloatArray = -(area[largest] @ normals[largest])
    return normal / np.linalg.norm(normal)


def _plane(normal: FloatArray, axes: FloatArray) -> FloatArray:
    """(3, 3) axes with a normal up and the robot's forward as far as it lies in the plane."""
    forward = axes[:, 0] - normal * (normal @ axes[:, 0])
    forward = forward / np.linalg.norm(forward)
    return np.stack([forward, np.cross(normal, forward), normal], axis=1)


def _hull(points: FloatArray) -> ConvexHull | None:
    try:
        return ConvexHull(points)
    except (QhullError, ValueError):
        return None


def _rectangle(hull: ConvexHull) -> tuple[float, float, float, float]:
    """Back, front, middle and half width of the largest upright rectangle inside a convex hull [m]."""
    normals, offsets = hull.equations[:, :2], hull.equations[:, 2]
    low, high = hull.points.min(axis=0), hull.points.max(axis=0)
    # Not at the very ends, where an edge that is a hair's breadth askew leaves a point of it.
    cuts = low[0] + np.linspace(0.001, 0.999, 41) * (high[0] - low[0])

    def span(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Least and greatest y inside the hull at x."""
        least, greatest = np.full(len(x), low[1]), np.full(len(x), high[1])
        for (nx, ny), offset in zip(normals, offsets, strict=True):
            if ny > 1e-9:
                greatest = np.minimum(greatest, (-offset - nx * x) / ny)
            elif ny < -1e-9:
                least = np.maximum(least, (-offset - nx * x) / ny)
        return least, greatest

    least, greatest = span(cuts)
    best = (-1.0, 0.0, 0.0, 0.0, 0.0)
    for i in range(len(cuts)):
        for j in range(i + 4, len(cuts)):
            right, left = max(least[i], least[j]), min(greatest[i], greatest[j])
            area = (cuts[j] - cuts[i]) * (left - right)
            if left > right and area > best[0]:
                best = (area, cuts[i], cuts[j], (left + right) / 2, (left - right) / 2)
    return best[1], best[2], best[3], best[4]


def capsule(points: FloatArray) -> Capsule:
    """One that holds nearly all of some points: along their longest axis, as thick as most of them are away from it.

    Args:
        points: (k, 3) in the body's frame [m], at least one.
    """
    points = points if len(hull := _corners(points)) < 4 else hull
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    along = (
        np.linalg.svd(points - points.mean(axis=0), full_matrices=True)[2][0]
        if len(points) > 2
        else np.array([0, 0, 1.0])
    )
    reach = (points - middle) @ along
    away = points - middle - np.outer(reach, along)
    middle = middle + away.mean(axis=0)
    away -= away.mean(axis=0)
    radius = float(np.percentile(np.linalg.norm(away, axis=1), 80))
    radius = max(radius, 0.004)
    half = max((float(np.ptp(reach)) / 2) - radius, 0.001)
    middle = middle + along * (reach.max() + reach.min()) / 2
    return Capsule(middle - along * half, middle + along * half, radius)


def _corners(points: FloatArray) -> FloatArray:
    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except (QhullError, ValueError):
        return points
