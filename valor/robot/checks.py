"""Whether robot.yaml and model.xml are of the same robot, and of one that stands well: each check finds what breaks it.

Rules that need no model stand in ``rules.py``, what is asked of the drives in ``drive_checks.py``.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from itertools import pairwise

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.table import TableError
from valor.robot import soles
from valor.robot.description import RobotDescription
from valor.robot.model import Model, full_model, robot_spec
from valor.robot.model_faults import coupled
from valor.robot.tables import Foot

SIDES = ("left", "right")
SOLE_HEIGHT = 0.01  # of a sole from the ground in the nominal posture, at most [m]
SOLE_PLANE = 0.005  # of a sole from the underside of its foot's geoms, at most [m]
SOLE_TILT = 0.02  # of a sole from level, and of its heading from the base's, at most [rad]
SOLE_SIZE = 0.02  # of a sole's edges from those of the foot's geoms, at most [m]
COM_MARGIN = 0.25  # of the CoM inside both soles' edges, at least, of a sole's half width
COUPLING = 0.005  # that a coupling may be away from satisfied in the nominal posture [m, rad]
LEG_TOLERANCE = 0.05  # of hip_height from the nominal posture's [m]
SIZE_TOLERANCE = 0.03  # of size from the model's, as a share


class Stance:
    """The robot in its nominal posture, its base where robot.yaml says, on the plane z = 0.

    Attributes:
        robot: the description.
        model: every joint, and the geoms that collide.
        data: all that MuJoCo computes of it at rest.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self.robot = robot
        self.model: Model = full_model(robot, "collision")
        self.data = mujoco.MjData(self.model.mj)
        self.data.qpos[:] = self.model.nominal_qpos()
        mujoco.mj_forward(self.model.mj, self.data)

    def foot(self, side: str) -> Foot:
        """The table of a foot."""
        foot: Foot = getattr(self.robot.tables.feet, side)
        return foot

    def site(self, name: str) -> tuple[FloatArray, FloatArray]:
        """(3,) position in the world [m], and (3, 3) orientation, of a site."""
        site = self.data.site(name)
        return site.xpos, site.xmat.reshape(3, 3)

    @cached_property
    def base(self) -> tuple[FloatArray, FloatArray]:
        """(3,) position, and (3, 3) orientation, of the base."""
        body = self.data.body(self.robot.tables.base)
        return body.xpos, body.xmat.reshape(3, 3)

    @property
    def com(self) -> FloatArray:
        """(3,) of the whole robot [m]."""
        com: FloatArray = self.data.subtree_com[self.model.body(self.robot.tables.base)]
        return com

    @cached_property
    def weight(self) -> float:
        """Of the whole robot [N]."""
        mj = self.model.mj
        return float(mj.body_subtreemass[self.model.body(self.robot.tables.base)] * -mj.opt.gravity[2])

    def above(self, body: int) -> list[str]:
        """The joints between the base and a body, from the base on."""
        return [name for name in reversed(self.model.joints_above(body)) if name in self.robot.index]

    def pitch_joints(self, side: str) -> list[str]:
        """Of a leg, those that turn about the base's lateral axis, from the hip to the ankle."""
        lateral = self.base[1][:, 1]
        group = self.robot.tables.group(f"{side}_leg")
        return [name for name in group if abs(self.data.joint(name).xaxis @ lateral) > 0.9]

    def leg_length(self, side: str) -> float:
        """From hip to ankle, straight [m]."""
        anchors = [self.data.joint(name).xanchor for name in self.pitch_joints(side)]
        return float(sum(np.linalg.norm(b - a) for a, b in pairwise(anchors)))

    def outline(self, side: str) -> soles.Points:
        """A sole's corners from above."""
        foot = self.foot(side)
        position, rotation = self.site(foot.sole)
        return soles.outline(position, rotation, foot)


def sites_are_on_their_bodies(stance: Stance) -> Iterator[TableError]:
    """A sole is on its foot, a hand's site on its hand, the IMU on the base."""
    tables, mj = stance.robot.tables, stance.model.mj
    wanted: list[tuple[tuple[str, ...], str, str]] = [(("imu", "site"), tables.imu.site, tables.base)]
    feet = [(side, stance.foot(side)) for side in SIDES]
    wanted += [(("feet", side, "sole"), foot.sole, foot.body) for side, foot in feet]
    wanted += [(("hands", side, "site"), hand.site, hand.body) for side, hand in tables.hands.present()]
    for path, site, body in wanted:
        if (found := mj.body(mj.site_bodyid[stance.model.site(site)]).name) != body:
            yield TableError(path, f"got {site!r}, which is on {found}; expected a site on {body}")


def torso_is_below_the_chest(stance: Stance) -> Iterator[TableError]:
    """The torso is the joints between base and chest."""
    yield from _differing(stance, "torso", stance.above(stance.model.body(stance.robot.tables.chest)))


def _differing(stance: Stance, group: str, chain: list[str]) -> Iterator[TableError]:
    if chain and group not in stance.robot.tables.groups:
        yield TableError(("groups", group), f"missing; expected {', '.join(chain)}")
    elif odd := sorted(set(stance.robot.tables.group(group)) ^ set(chain)):
        yield TableError(("groups", group), f"expected {', '.join(chain) or 'none'}; in one of both only: {odd}")


def sides_are_where_they_are_said_to_be(stance: Stance) -> Iterator[TableError]:
    """Left of the base is left, y > 0: soles, and the shoulders of the hands, which may cross."""
    tables, body = stance.robot.tables, stance.model.body
    torso = stance.above(body(tables.chest))
    for side in SIDES:
        foot, hand = stance.foot(side), getattr(tables.hands, side)
        places = [("feet", foot.body, stance.site(foot.sole)[0])]
        if hand is not None:
            arm = [name for name in stance.above(body(hand.body)) if name not in torso]
            places += [("hands", hand.body, stance.data.joint(name).xanchor) for name in arm[:1]]
        for limbs, name, place in places:
            lateral = float((place - stance.base[0]) @ stance.base[1][:, 1])
            if lateral * (1 if side == "left" else -1) <= 0:
                what = f"got {name!r}, which is {abs(lateral):.2f} m to the other side; expected the {side} one"
                yield TableError((limbs, side, "body"), what)


def groups_are_what_they_are_called(stance: Stance) -> Iterator[TableError]:
    """Legs and arms are the joints between base and feet, chest and hands; fingers and neck lie beyond.

    An arm without a hand hangs on the chest as the neck does.
    """
    tables, body = stance.robot.tables, stance.model.body
    torso = stance.above(body(tables.chest))
    beyond = {"neck": tables.chest}
    for side in SIDES:
        arm, hand, fingers = f"{side}_arm", getattr(tables.hands, side), f"{side}_hand"
        yield from _differing(stance, f"{side}_leg", stance.above(body(stance.foot(side).body)))
        if hand is None:
            beyond[arm] = tables.chest
            yield from _differing(stance, fingers, [])
        else:
            beyond[fingers] = hand.body
            above = stance.above(body(hand.body))
            yield from _differing(stance, arm, [name for name in above if name not in torso])
    for group, root in beyond.items():
        for place, name in enumerate(tables.group(group)):
            if not set(stance.above(body(root))) < set(stance.above(int(stance.model.mj.joint(name).bodyid[0]))):
                yield TableError(("groups", group, str(place)), f"got {name!r}; expected a joint beyond {root}")


def soles_stand_on_the_ground(stance: Stance) -> Iterator[TableError]:
    """In the nominal posture both soles are level, point forward, and are as far below the base as it says."""
    forward = stance.base[1][:, 0]
    for side in SIDES:
        foot = stance.foot(side)
        position, rotation = stance.site(foot.sole)
        if abs(position[2]) > SOLE_HEIGHT:
            height = stance.robot.tables.nominal_base_height
            what = f"got {height}; expected {height - position[2]:.4f}, at which {foot.sole} stands on the ground"
            yield TableError(("nominal_base_height",), what)
        tilt, turn = np.arccos(np.clip([rotation[2, 2], rotation[:, 0] @ forward], -1, 1)).tolist()
        if tilt > SOLE_TILT:
            yield TableError(("nominal_posture",), f"tilts {foot.sole} by {tilt:.3f} rad; expected both soles level")
        elif turn > SOLE_TILT:
            yield TableError(("feet", side, "sole"), f"points {turn:.2f} rad away from forward; expected x forward")


def soles_are_as_large_as_the_feet(stance: Stance) -> Iterator[TableError]:
    """Edges of soles are where the foot's geoms touch the ground."""
    for side in SIDES:
        foot = stance.foot(side)
        points = _footprint(stance, foot)
        if not len(points):
            yield TableError(("feet", side, "body"), f"got {foot.body!r}; expected a body whose geoms reach its sole")
            continue
        (back, right), (front, left) = points.min(axis=0), points.max(axis=0)
        for key, found, wanted in (
            ("heel", foot.heel, back),
            ("toe", foot.toe, front),
            ("half_width", foot.half_width, max(left, -right)),
        ):
            if abs(found - wanted) > SOLE_SIZE:
                yield TableError(
                    ("feet", side, key), f"got {found}; expected {wanted:.3f}, as the geoms of {foot.body}"
                )


def _footprint(stance: Stance, foot: Foot) -> FloatArray:
    """(k, 2) where the geoms of a foot touch the plane of its sole, in the sole's frame [m]."""
    mj, data = stance.model.mj, stance.data
    origin, rotation = stance.site(foot.sole)
    points = []
    for geom in np.flatnonzero(mj.geom_bodyid == stance.model.body(foot.body)):
        centre, half = mj.geom_aabb[geom, :3], mj.geom_aabb[geom, 3:]
        ball = mj.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE
        signs = np.zeros((1, 3)) if ball else np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
        corners = data.geom_xpos[geom] + (centre + signs * half) @ data.geom_xmat[geom].reshape(3, 3).T
        seen = (corners - origin) @ rotation
        lowest = seen[:, 2].min() - (half[0] if ball else 0.0)
        if lowest < SOLE_HEIGHT:
            points += [point[:2] for point in seen if ball or point[2] < lowest + SOLE_HEIGHT]
    return np.array(points)


def soles_lie_on_their_geoms(stance: Stance) -> Iterator[TableError]:
    """A sole's plane is that of the foot's underside."""
    for side in SIDES:
        foot = stance.foot(side)
        origin, rotation = stance.site(foot.sole)
        geoms = np.flatnonzero(stance.model.mj.geom_bodyid == stance.model.body(foot.body))
        depths = [((_corners(stance, int(geom)) - origin) @ rotation)[:, 2].min() for geom in geoms]
        lowest = float(min(depths, default=0.0))
        if abs(lowest) > SOLE_PLANE:
            where = f"{abs(lowest):.3f} m {'below' if lowest > 0 else 'above'} the lowest geom of {foot.body}"
            yield TableError(("feet", side, "sole"), f"got {foot.sole!r}, which is {where}; expected it there")


def _corners(stance: Stance, geom: int) -> FloatArray:
    """(k, 3) of a geom's surface or of the box around it, in the world [m]."""
    mj, data = stance.model.mj, stance.data
    rotation = data.geom_xmat[geom].reshape(3, 3)
    if mj.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(mj.geom_dataid[geom])
        points = np.asarray(mj.mesh_vert[mj.mesh_vertadr[mesh] :][: mj.mesh_vertnum[mesh]], dtype=np.float64)
    elif mj.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE:
        points = mj.geom_size[geom][0] * np.concatenate([np.eye(3), -np.eye(3)]) @ rotation
    else:
        signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
        points = mj.geom_aabb[geom, :3] + signs * mj.geom_aabb[geom, 3:]
    corners: FloatArray = data.geom_xpos[geom] + points @ rotation.T
    return corners


def feet_stand_apart(stance: Stance) -> Iterator[TableError]:
    """In the nominal posture, and as narrow as steps may be, the soles do not stand on each other."""
    footsteps, width = stance.robot.tables.footsteps, sum(stance.foot(side).half_width for side in SIDES)
    if footsteps is not None and footsteps.min_width < width:
        what = f"got {footsteps.min_width}; expected at least {width:g}, at which the soles touch"
        yield TableError(("footsteps", "min_width"), what)
    if soles.overlap(*(stance.outline(side) for side in SIDES)):
        yield TableError(("nominal_posture",), "puts one sole on the other; expected them apart")


def couplings_hold(stance: Stance) -> Iterator[TableError]:
    """In the nominal posture what couples joints, or closes loops, is satisfied where passive joints rest."""
    robot, spec = stance.robot, robot_spec(stance.robot, "none", passive=True)
    if not any(each.simulated for each in robot.tables.passive.values()) or not spec.equalities:
        return
    joints = [sorted({*coupled(spec, each)} & {*robot.tables.passive}) for each in spec.equalities]
    model = Model(robot, spec.compile())
    data = mujoco.MjData(model.mj)
    data.qpos[:] = model.nominal_qpos()
    mujoco.mj_fwdPosition(model.mj, data)
    for equality, names in enumerate(joints):
        rows = data.efc_id[: data.ne] == equality  # which come first
        gap = float(np.abs(data.efc_pos[: data.ne][rows]).max(initial=0.0))
        if gap > COUPLING and names:
            what = f"what couples it is {gap:.3f} (m or rad) from closed; expected the angle at which it is"
            yield TableError(("passive", names[0], "at"), what)


def nothing_touches(stance: Stance) -> Iterator[TableError]:
    """In the nominal posture the robot does not touch itself."""
    for one, other in touching(stance.model, stance.data):
        yield TableError(("nominal_posture",), f"{one} touches {other}; expected nothing to touch")


def touching(model: Model, data: mujoco.MjData) -> list[tuple[str, str]]:
    """Pairs of bodies in contact, each once."""
    mj = model.mj
    pairs = (sorted(mj.body(mj.geom_bodyid[geom]).name for geom in contact.geom) for contact in data.contact)
    return sorted({(one, other) for one, other in pairs})


def arm_presets_touch_nothing(stance: Stance) -> Iterator[TableError]:
    """Either arm alone, or both, at a preset of theirs: the robot does not touch itself."""
    model, data = stance.model, mujoco.MjData(stance.model.mj)
    for preset, postures in stance.robot.tables.arm_presets.items():
        faulty = False
        for sides in (*((side,) for side in postures), tuple(postures)):
            if len(sides) > 1 and faulty:
                continue
            data.qpos[:] = model.nominal_qpos()
            for side in sides:
                for name, angle in postures[side].items():
                    data.qpos[model.mj.joint(name).qposadr[0]] = angle
            mujoco.mj_forward(model.mj, data)
            for one, other in touching(model, data):
                faulty, both = True, " with both arms" if len(sides) > 1 else ""
                path = ("arm_presets", preset, *(sides if len(sides) == 1 else ()))
                yield TableError(path, f"{one} touches {other}{both}; expected nothing to touch")


def pairs_are_kept_apart(stance: Stance) -> Iterator[TableError]:
    """In the nominal posture all that is kept apart is farther apart than it is kept."""
    collision, model = stance.robot.tables.self_collision, stance.model
    for place, pair in enumerate(collision.pairs):
        bare = [body for body in pair if not (model.mj.geom_bodyid == model.body(body)).any()]
        if bare:
            what = f"got {bare[0]!r}, which has no geoms that collide"
            yield TableError(("self_collision", "pairs", str(place)), what)
            continue
        one, other = (model.shape(body) for body in pair)
        apart = mujoco.mj_geomDistance(model.mj, stance.data, one, other, 1.0, None)
        if apart < collision.distance:
            what = f"got {collision.distance}; expected less than the {apart:.3f} m between {pair[0]} and {pair[1]}"
            yield TableError(("self_collision", "distance"), what)


def the_com_is_over_the_soles(stance: Stance) -> Iterator[TableError]:
    """In the nominal posture the CoM is well inside the convex hull of both soles."""
    inside = com_margin(stance)
    least = COM_MARGIN * min(stance.foot(side).half_width for side in SIDES)
    if inside < least:
        what = f"puts the CoM {inside:.3f} m inside the soles' edges; expected at least {least:.3f}"
        yield TableError(("nominal_posture",), what)


def com_margin(stance: Stance) -> float:
    """How far the CoM is inside the convex hull of both soles, seen from above [m]; negative outside."""
    corners = np.array([point for side in SIDES for point in stance.outline(side)])
    com = stance.com[:2]
    # Distance to a convex hull's edges: the least, over all lines through two corners with every corner on one side.
    margin = np.inf
    for i, a in enumerate(corners):
        for b in corners[i + 1 :]:
            along = b - a
            normal = np.array([-along[1], along[0]]) / max(float(np.linalg.norm(along)), 1e-9)
            sides = (corners - a) @ normal
            if sides.min() > -1e-9:
                margin = min(margin, float((com - a) @ normal))
            elif sides.max() < 1e-9:
                margin = min(margin, float((a - com) @ normal))
    return margin


def the_size_is_the_models(stance: Stance) -> Iterator[TableError]:
    """``size`` has the straight leg's length and the mass of the model: defaults go by them."""
    size = stance.robot.tables.size
    leg = sum(stance.leg_length(side) for side in SIDES) / len(SIDES)
    mass = stance.weight / -stance.model.mj.opt.gravity[2]
    for key, found, wanted in (("leg", size.leg, leg), ("mass", size.mass, mass)):
        if abs(found / wanted - 1) > SIZE_TOLERANCE:
            yield TableError(("size", key), f"got {found}; expected {wanted:.4g}, as the model has it")


def legs_are_as_long_as_walking_says(stance: Stance) -> Iterator[TableError]:
    """``hip_height`` is that of the nominal posture, and ``leg_reach`` leaves the knee bent."""
    walking = stance.robot.tables.walking
    for side in SIDES:
        anchors = [stance.data.joint(name).xanchor for name in stance.pitch_joints(side)]
        height = float(anchors[0][2] - anchors[-1][2])
        length = stance.leg_length(side)
        if abs(walking.hip_height - height) > LEG_TOLERANCE:
            what = f"got {walking.hip_height}; expected {height:.3f}, as in the nominal posture"
            yield TableError(("walking", "hip_height"), what)
        if walking.leg_reach >= length:
            what = f"got {walking.leg_reach}; expected less than the straight leg's {length:.3f}"
            yield TableError(("walking", "leg_reach"), what)
