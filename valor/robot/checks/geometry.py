"""Checks of robot.yaml against model.xml, in the nominal posture. Each check yields its violations."""

from collections.abc import Iterator

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.table import TableError
from valor.robot import soles
from valor.robot.checks.model_file import coupled
from valor.robot.checks.stance import Stance, touching
from valor.robot.model import Model, robot_spec
from valor.robot.tables import SIDES, Foot

SOLE_HEIGHT = 0.01  # largest distance of a sole from the ground in the nominal posture [m]
SOLE_PLANE = 0.005  # largest distance of a sole from the underside of its foot's geoms [m]
SOLE_TILT = 0.02  # largest tilt of a sole, and largest angle between its heading and the base's [rad]
SOLE_SIZE = 0.02  # largest distance of a sole's edges from those of the foot's geoms [m]
COM_MARGIN = 0.25  # least distance of the CoM inside the edges of both soles, in half widths of a sole
COUPLING = 0.005  # largest residual of a coupling in the nominal posture [m, rad]
LEG_TOLERANCE = 0.05  # largest difference of hip_height from that of the nominal posture [m]
SIZE_TOLERANCE = 0.03  # largest relative difference of size from the model's


def sites_are_on_their_bodies(stance: Stance) -> Iterator[TableError]:
    """Check that each sole is on its foot, each hand site on its hand and each IMU on the base."""
    tables, mj = stance.robot.tables, stance.model.mj
    wanted: list[tuple[tuple[str, ...], str, str]] = [(("imu", "site"), tables.imu.site, tables.base)]
    wanted += [] if tables.kvh is None else [(("kvh", "site"), tables.kvh.site, tables.base)]
    feet = [(side, stance.foot(side)) for side in SIDES]
    wanted += [(("feet", side, "sole"), foot.sole, foot.body) for side, foot in feet]
    wanted += [(("hands", side, "site"), hand.site, hand.body) for side, hand in tables.hands.present()]
    for path, site, body in wanted:
        if (found := mj.body(mj.site_bodyid[stance.model.site(site)]).name) != body:
            yield TableError(path, f"got {site!r}, which is on {found}; expected a site on {body}")


def imu_is_near_the_base(stance: Stance) -> Iterator[TableError]:
    """Check that the IMU's site is at most a leg's length from the base's frame."""
    site = stance.robot.tables.imu.site
    away, leg = float(np.linalg.norm(stance.site(site)[0] - stance.base[0])), stance.leg_length("left")
    if away > leg:
        yield TableError(("imu", "site"), f"got {site!r}, {away:.3g} m from the base; expected at most {leg:.2f} m")


def torso_is_below_the_chest(stance: Stance) -> Iterator[TableError]:
    """Check that group torso has the joints between base and chest."""
    yield from _differing(stance, "torso", stance.above(stance.model.body(stance.robot.tables.chest)))


def _differing(stance: Stance, group: str, chain: list[str]) -> Iterator[TableError]:
    if chain and group not in stance.robot.tables.groups:
        yield TableError(("groups", group), f"missing; expected {', '.join(chain)}")
    elif odd := sorted(set(stance.robot.tables.group(group)) ^ set(chain)):
        yield TableError(("groups", group), f"expected {', '.join(chain) or 'none'}; in one of both only: {odd}")


def limbs_are_on_their_sides(stance: Stance) -> Iterator[TableError]:
    """Check that left soles and shoulders have y > 0 in the base, right ones y < 0. Hands may cross."""
    tables, body = stance.robot.tables, stance.model.body
    torso = stance.above(body(tables.chest))
    for side in SIDES:
        foot, hand = stance.foot(side), getattr(tables.hands, side)
        positions = [("feet", foot.body, stance.site(foot.sole)[0])]
        if hand is not None:
            arm = [name for name in stance.above(body(hand.body)) if name not in torso]
            positions += [("hands", hand.body, stance.data.joint(name).xanchor) for name in arm[:1]]
        for limbs, name, position in positions:
            lateral = float((position - stance.base[0]) @ stance.base[1][:, 1])
            if lateral * (1 if side == "left" else -1) <= 0:
                what = f"got {name!r}, which is {abs(lateral):.2f} m to the other side; expected the {side} one"
                yield TableError((limbs, side, "body"), what)


def groups_match_their_limbs(stance: Stance) -> Iterator[TableError]:
    """Check that legs are the joints from base to foot and arms those from chest to hand.

    Fingers are below a hand; neck, and an arm without a hand, are below the chest.
    """
    tables, body = stance.robot.tables, stance.model.body
    torso = stance.above(body(tables.chest))
    below = {"neck": tables.chest}
    for side in SIDES:
        arm, hand, fingers = f"{side}_arm", getattr(tables.hands, side), f"{side}_hand"
        yield from _differing(stance, f"{side}_leg", stance.above(body(stance.foot(side).body)))
        if hand is None:
            below[arm] = tables.chest
            yield from _differing(stance, fingers, [])
        else:
            below[fingers] = hand.body
            above = stance.above(body(hand.body))
            yield from _differing(stance, arm, [name for name in above if name not in torso])
    for group, root in below.items():
        for index, name in enumerate(tables.group(group)):
            if not set(stance.above(body(root))) < set(stance.above(int(stance.model.mj.joint(name).bodyid[0]))):
                yield TableError(("groups", group, str(index)), f"got {name!r}; expected a joint below {root}")


def soles_stand_on_the_ground(stance: Stance) -> Iterator[TableError]:
    """Check that in the nominal posture both soles are level, point forward and touch the plane z = 0."""
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
    """Check the edges of each sole against the footprint of its foot's geoms."""
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
    """Return (k, 2) points where the geoms of a foot touch the plane of its sole, in the sole's frame [m]."""
    points = []
    for seen in _surfaces(stance, foot):
        if (lowest := seen[:, 2].min()) < SOLE_HEIGHT:
            points += [point[:2] for point in seen if point[2] < lowest + SOLE_PLANE]
    return np.array(points)


def soles_lie_on_their_geoms(stance: Stance) -> Iterator[TableError]:
    """Check that each sole's plane is the underside of its foot."""
    for side in SIDES:
        foot = stance.foot(side)
        lowest = float(min((seen[:, 2].min() for seen in _surfaces(stance, foot)), default=0.0))
        if abs(lowest) > SOLE_PLANE:
            where = f"{abs(lowest):.3f} m {'below' if lowest > 0 else 'above'} the lowest geom of {foot.body}"
            yield TableError(("feet", side, "sole"), f"got {foot.sole!r}, which is {where}; expected it there")


def _surfaces(stance: Stance, foot: Foot) -> Iterator[FloatArray]:
    """Yield (k, 3) points of each geom of a foot, or of its bounding box, in the sole's frame [m]."""
    mj, data = stance.model.mj, stance.data
    origin, axes = stance.site(foot.sole)
    for geom in np.flatnonzero(mj.geom_bodyid == stance.model.body(foot.body)):
        rotation = data.geom_xmat[geom].reshape(3, 3)
        if mj.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = int(mj.geom_dataid[geom])
            points = np.asarray(mj.mesh_vert[mj.mesh_vertadr[mesh] :][: mj.mesh_vertnum[mesh]], dtype=np.float64)
        elif mj.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE:
            points = mj.geom_size[geom][0] * np.concatenate([np.eye(3), -np.eye(3)]) @ rotation
        else:
            signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
            points = mj.geom_aabb[geom, :3] + signs * mj.geom_aabb[geom, 3:]
        yield (data.geom_xpos[geom] + points @ rotation.T - origin) @ axes


def feet_stand_apart(stance: Stance) -> Iterator[TableError]:
    """Check that the soles do not overlap in the nominal posture, nor at the least step width."""
    footsteps, width = stance.robot.tables.footsteps, sum(stance.foot(side).half_width for side in SIDES)
    if footsteps is not None and footsteps.min_width < width:
        what = f"got {footsteps.min_width}; expected at least {width:g}, at which the soles touch"
        yield TableError(("footsteps", "min_width"), what)
    if soles.overlap(*(stance.outline(side) for side in SIDES)):
        yield TableError(("nominal_posture",), "puts one sole on the other; expected them apart")


def couplings_hold(stance: Stance) -> Iterator[TableError]:
    """Check that couplings and loops are satisfied in the nominal posture, with passive joints at rest."""
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
            what = f"residual of its coupling is {gap:.3f} (m or rad); expected an angle that closes it"
            yield TableError(("passive", names[0], "at"), what)


def nothing_touches(stance: Stance) -> Iterator[TableError]:
    """Check that the robot does not touch itself in the nominal posture."""
    for one, other in touching(stance.model, stance.data):
        yield TableError(("nominal_posture",), f"{one} touches {other}; expected nothing to touch")


def arm_presets_touch_nothing(stance: Stance) -> Iterator[TableError]:
    """Check that the robot does not touch itself with one arm or both at a preset."""
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
    """Check that pairs of ``self_collision`` are farther apart than its distance in the nominal posture."""
    collision, model = stance.robot.tables.self_collision, stance.model
    for index, pair in enumerate(collision.pairs):
        bare = [body for body in pair if not (model.mj.geom_bodyid == model.body(body)).any()]
        if bare:
            what = f"got {bare[0]!r}, which has no geoms that collide"
            yield TableError(("self_collision", "pairs", str(index)), what)
            continue
        one, other = (model.shape(body) for body in pair)
        apart = mujoco.mj_geomDistance(model.mj, stance.data, one, other, 1.0, None)
        if apart < collision.distance:
            what = f"got {collision.distance}; expected less than the {apart:.3f} m between {pair[0]} and {pair[1]}"
            yield TableError(("self_collision", "distance"), what)


def com_is_over_the_soles(stance: Stance) -> Iterator[TableError]:
    """Check that the CoM is inside the convex hull of both soles, with a margin, in the nominal posture."""
    x, y, _ = stance.com.tolist()
    hull = soles.convex_hull(point for side in SIDES for point in stance.outline(side))
    inside = -soles.distance_outside(hull, x, y)
    least = COM_MARGIN * min(stance.foot(side).half_width for side in SIDES)
    if inside < least:
        what = f"puts the CoM {inside:.3f} m inside the soles' edges; expected at least {least:.3f}"
        yield TableError(("nominal_posture",), what)


def size_matches_the_model(stance: Stance) -> Iterator[TableError]:
    """Check ``size``, by which defaults scale, against the model's straight leg and mass."""
    size = stance.robot.tables.size
    leg = stance.mean_leg_length
    mass = stance.weight / -stance.model.mj.opt.gravity[2]
    for key, found, wanted in (("leg", size.leg, leg), ("mass", size.mass, mass)):
        if abs(found / wanted - 1) > SIZE_TOLERANCE:
            yield TableError(("size", key), f"got {found}; expected the model's {wanted:.4g}")


def walking_matches_the_legs(stance: Stance) -> Iterator[TableError]:
    """Check ``hip_height`` against the nominal posture; ``leg_reach`` must leave the knee bent."""
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
