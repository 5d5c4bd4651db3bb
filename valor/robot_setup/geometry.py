"""Shapes of a model's bodies: soles, palms and capsules fitted to points on them."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from valor.common.arrays import FloatArray
from valor.robot_setup.skeleton import Skeleton
from valor.robot_setup.source import Source

_TOUCHING = 0.015  # distance of points on a foot's lowest plane from it, relative to the foot's length
_LEVEL = 0.85  # minimum cosine between the underside's normal and the vertical, as drawn
_SAME = 0.997  # minimum cosine between the normals of facets of one plane
_CIRCLE = 12  # points around a circle
_PLANE = 0.03  # distance of another part's underside from a sole's plane, relative to the sole's length
_BALL = 0.01  # radius of a sole's corners, ESCHER's [m]
_GROUND = 0.02  # difference in height between undersides on the ground, relative to the leg's length


@dataclass(frozen=True)
class Sole:
    """Rectangle on the underside of a foot, in the world as drawn."""

    origin: FloatArray  # (3,) below the ankle [m]
    rotation: FloatArray  # (3, 3) axes forward, left, up
    heel: float  # x of the back edge [m]
    toe: float  # x of the front edge [m]
    half_width: float  # [m]

    @property
    def length(self) -> float:
        """Length [m]."""
        return self.toe - self.heel


@dataclass(frozen=True)
class Capsule:
    """Capsule in a body's frame: two ends (3,) and a radius [m]."""

    start: FloatArray
    end: FloatArray
    radius: float


@dataclass
class ModelGeometry:
    """Shapes and sites of the generated model."""

    soles: dict[str, Sole]  # by side
    palms: dict[str, FloatArray]  # (3,) by side, origin of hand goals, in the world as drawn [m]
    pads: dict[int, Sole] = field(default_factory=dict)  # other parts of a foot on the ground, on passive hinges
    capsules: dict[int, Capsule] = field(default_factory=dict)  # by body
    excluded: list[tuple[str, str]] = field(default_factory=list)  # bodies that overlap at rest and do not collide
    step: float = 0.001  # of the physics [s]

    @property
    def ball(self) -> float:
        """Radius of a sole's corners [m]. Much smaller ones catch on the edges between a height field's cells."""
        return min(_BALL, 0.5 * min(sole.half_width for sole in self.soles.values()))


def fit_geometry(robot: Skeleton) -> ModelGeometry:
    """Fit soles, palms, and a capsule to each rigid part with a shape.

    Moves the ends of limbs divided by passive hinges: to the part at the wrist, and to the part a foot stands on.
    Raises ConfigurationError: a foot has no flat underside.
    """
    _choose_ends(robot)
    soles = {side: _foot_sole(robot, side) for side in robot.legs}
    # Shapes of both feet may differ slightly, and then the largest rectangles much: the part in both.
    heel, toe = max(sole.heel for sole in soles.values()), min(sole.toe for sole in soles.values())
    half_width = min(sole.half_width for sole in soles.values())
    soles = {side: replace(sole, heel=heel, toe=toe, half_width=half_width) for side, sole in soles.items()}
    found = ModelGeometry(soles, {side: _palm(robot, side) for side in robot.arms})
    source = robot.source
    feet = {leg.end: side for side, leg in robot.legs.items()}
    seen: set[int] = set()
    for body in sorted(robot.edges):
        if body in seen:
            continue
        bodies = robot.rigid(body)
        seen |= set(bodies)
        main = source.heaviest(bodies)
        if foot := next((each for each in bodies if each in feet), None):
            found.capsules[foot] = _foot_capsule(robot, foot, found.soles[feet[foot]])
        elif pad := _pad(robot, bodies, found.soles):
            found.pads[main] = pad
        elif len(points := surface_points(source, bodies)) > 3:
            found.capsules[main] = fit_capsule((points - source.data.xpos[main]) @ source.rotation(main))
    return found


def leg_length(robot: Skeleton) -> float:
    """Return the approximate length of a leg, between its joints' anchors as drawn [m]."""
    anchors = robot.source.data.xanchor[robot.legs["left"].joints]
    return float(np.linalg.norm(np.diff(anchors, axis=0), axis=1).sum())


def _choose_ends(robot: Skeleton) -> None:
    """Choose the part of a divided hand at the wrist, and the longest of the lowest parts of a divided foot."""
    source = robot.source
    for arm in robot.arms.values():
        wrist = int(source.mj.jnt_bodyid[arm.joints[-1]])
        if wrist in robot.link(arm.end):
            arm.end = source.heaviest(robot.rigid(wrist))
    for leg in robot.legs.values():
        parts = {tuple(robot.rigid(body)) for body in robot.link(leg.end)}
        ankle = source.data.xanchor[leg.joints[-1]]
        soles = {part: fit_sole(surface_points(source, part), ankle, robot.forward) for part in sorted(parts)}
        found = {part: each for part, each in soles.items() if each is not None}
        if len(parts) < 2 or not found:
            continue
        heights = {part: float(each.origin @ robot.forward[:, 2]) for part, each in found.items()}
        highest = min(heights.values()) + _GROUND * leg_length(robot)
        low = [part for part, height in heights.items() if height < highest]
        longest = max(low, key=lambda part: found[part].length)
        leg.end = source.heaviest(longest)


def _foot_sole(robot: Skeleton, side: str) -> Sole:
    leg, source = robot.legs[side], robot.source
    points = surface_points(source, robot.rigid(leg.end))
    found = fit_sole(points, source.data.xanchor[leg.joints[-1]], robot.forward)
    if found is None:
        omitted = "".join(f"; {note}" for note in source.notes if note.startswith("Shapes left out"))
        raise source.fail(f"body {robot.name(leg.end)}: no flat underside found; expected geoms to stand on{omitted}")
    return found


def _palm(robot: Skeleton, side: str) -> FloatArray:
    """Return the point two thirds of the way from the wrist to the hand's far end, (3,) as drawn [m]."""
    limb, source = robot.arms[side], robot.source
    wrist = source.data.xanchor[limb.joints[-1]]
    points = surface_points(source, robot.link(limb.end))
    if not len(points):
        return np.asarray(source.data.xipos[limb.end])
    centre: FloatArray = points.mean(axis=0)
    away = centre - wrist
    length = float(np.linalg.norm(away))
    if length < 1e-6:
        return centre
    far = float(((points - wrist) @ away).max()) / length
    palm: FloatArray = wrist + away / length * max(far * 2 / 3, length)
    return palm


def _pad(robot: Skeleton, bodies: list[int], soles: dict[str, Sole]) -> Sole | None:
    """Return the underside of a part of a foot if it is in the plane of the foot's sole."""
    for side, leg in robot.legs.items():
        if bodies[0] in robot.link(leg.end):
            own = soles[side]
            found = fit_sole(surface_points(robot.source, bodies), own.origin, robot.forward)
            if found and abs(own.rotation[:, 2] @ (found.origin - own.origin)) < _PLANE * own.length:
                return found
    return None


def _foot_capsule(robot: Skeleton, foot: int, sole: Sole) -> Capsule:
    """Return a capsule along the foot, slightly above its sole so that only the sole touches the ground."""
    source = robot.source
    radius = min(sole.half_width, sole.length / 4) * 0.7
    ends = [
        sole.origin + sole.rotation @ np.array([x, 0.0, 1.3 * radius]) for x in (sole.heel + radius, sole.toe - radius)
    ]
    start, end = ((each - source.data.xpos[foot]) @ source.rotation(foot) for each in ends)
    return Capsule(start, end, radius)


def surface_points(source: Source, bodies: Iterable[int]) -> FloatArray:
    """Return points on the colliding geoms of bodies, or on all if none collide, (k, 3) as drawn [m]."""
    mj, geoms = source.mj, source.geoms(bodies)
    geoms = [g for g in geoms if mj.geom_contype[g] or mj.geom_conaffinity[g]] or geoms
    return np.concatenate([_geom_points(source, geom) for geom in geoms]) if geoms else np.zeros((0, 3))


def _geom_points(source: Source, geom: int) -> FloatArray:
    """Return vertices, corners, or the extreme points of a round geom, (k, 3) as drawn [m]."""
    mj, size = source.mj, source.mj.geom_size[geom]
    angle = np.linspace(0.0, 2 * np.pi, _CIRCLE, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    # The points of a ball farthest along the world's axes; it touches the ground at the lowest one.
    ball = np.concatenate([np.eye(3), -np.eye(3)]) @ source.data.geom_xmat[geom].reshape(3, 3)
    kind = mujoco.mjtGeom(int(mj.geom_type[geom]))
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(mj.geom_dataid[geom])
        first, count = mj.mesh_vertadr[mesh], mj.mesh_vertnum[mesh]
        points = np.asarray(mj.mesh_vert[first : first + count], dtype=np.float64)
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        points = size[0] * ball
    elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        points = size * ball
    elif kind in (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_CYLINDER):
        around = ball if kind == mujoco.mjtGeom.mjGEOM_CAPSULE else circle
        points = np.concatenate([size[0] * around + [0, 0, end * size[1]] for end in (-1, 1)])
    else:
        return source.box_corners(geom)
    return source.in_world(geom, points)


def fit_sole(points: FloatArray, ankle: FloatArray, axes: FloatArray) -> Sole | None:
    """Fit the largest rectangle, along the foot, to the flat underside of a foot; None if it has none.

    ``points`` (k, 3) of its surface and ``ankle`` (3,) are in the world as drawn [m]; ``axes``: forward, left, up.
    """
    if len(points) < 3:
        return None
    near = _TOUCHING * max(float(np.ptp(points @ axes[:, 0])), 0.05)
    normal = _underside(points, axes[:, 2])
    forward = axes[:, 0] - normal * (normal @ axes[:, 0])
    forward = forward / np.linalg.norm(forward)
    rotation = np.stack([forward, np.cross(normal, forward), normal], axis=1)
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
    """Return the upward normal of the largest plane below a foot, (3,)."""
    hull = _hull(points)
    if hull is None:
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


def _hull(points: FloatArray) -> ConvexHull | None:
    try:
        return ConvexHull(points)
    except (QhullError, ValueError):
        return None


def _rectangle(hull: ConvexHull) -> tuple[float, float, float, float]:
    """Return back, front, middle and half width of the largest upright rectangle inside a convex hull [m]."""
    low, high = hull.points.min(axis=0), hull.points.max(axis=0)
    # Not at the very ends, where a slightly oblique edge leaves only one of its points.
    cuts = low[0] + np.linspace(0.001, 0.999, 41) * (high[0] - low[0])
    least, greatest = np.full(len(cuts), low[1]), np.full(len(cuts), high[1])  # y inside the hull at each cut
    for nx, ny, offset in hull.equations:
        if ny > 1e-9:
            greatest = np.minimum(greatest, (-offset - nx * cuts) / ny)
        elif ny < -1e-9:
            least = np.maximum(least, (-offset - nx * cuts) / ny)
    best = (-1.0, 0.0, 0.0, 0.0, 0.0)
    for i in range(len(cuts)):
        for j in range(i + 4, len(cuts)):
            right, left = max(least[i], least[j]), min(greatest[i], greatest[j])
            area = (cuts[j] - cuts[i]) * (left - right)
            if left > right and area > best[0]:
                best = (area, cuts[i], cuts[j], (left + right) / 2, (left - right) / 2)
    return best[1], best[2], best[3], best[4]


def fit_capsule(points: FloatArray) -> Capsule:
    """Fit a capsule to points (k, 3), k ≥ 1, in the body's frame [m]: along their longest axis, around 80 % of them."""
    hull = _hull(points)
    points = points if hull is None else np.asarray(points[hull.vertices])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=True)[2]
    along = axes[0] if len(points) > 2 else np.array([0, 0, 1.0])
    reach = (points - middle) @ along
    away = points - middle - np.outer(reach, along)
    middle = middle + away.mean(axis=0)
    away -= away.mean(axis=0)
    radius = max(float(np.percentile(np.linalg.norm(away, axis=1), 80)), 0.004)
    half = max((float(np.ptp(reach)) / 2) - radius, 0.001)
    middle = middle + along * (reach.max() + reach.min()) / 2
    return Capsule(middle - along * half, middle + along * half, radius)
