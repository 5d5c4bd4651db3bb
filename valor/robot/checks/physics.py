"""Checks of model.xml for masses, inertias and friction that no machine of its size has."""

from collections.abc import Iterator

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.robot.checks.model_file import model_fault
from valor.robot.checks.stance import Stance

OUTSIDE = 0.25  # largest distance of a CoM outside its body's joints and geoms, relative to the straight leg
DENSEST = 2e4  # tungsten's density [kg/m³]
POINT = 0.02  # of the inertia of a ball of tungsten: a body with less is a point mass
POINTS = 0.5  # largest share of the mass in point masses: makers leave the inertias of some bodies out
SMALL = 5e-3  # inertia that may be too large for its body, relative to the robot's mass times leg²
LARGEST, MARGIN = 1.5, 0.05  # of geoms: distance from the body's frame, and contact margin, relative to the leg
BELOW = 0.1  # largest reach of a geom below the ground in the nominal posture, relative to the leg
FRICTION = (0.1, 5.0)  # sliding, of geoms that collide


def masses_fit_their_bodies(stance: Stance) -> Iterator[ConfigurationError]:
    """Check that the CoM of each body is near its joints and geoms; bodies without joints belong to their parents."""
    mj, data = stance.model.mj, stance.data
    margin = OUTSIDE * stance.mean_leg_length
    for root in np.unique(mj.body_weldid[1:]):
        bodies = np.flatnonzero((mj.body_weldid == root) & (mj.body_mass > 0.0))
        if not root or not len(bodies):
            continue
        lower, upper = _extent(mj, data, int(root))
        com = np.average(data.xipos[bodies], axis=0, weights=mj.body_mass[bodies])
        outside = float(np.linalg.norm(np.maximum(0.0, np.maximum(lower - com, com - upper))))
        if outside > margin:
            heaviest = mj.body(bodies[np.argmax(mj.body_mass[bodies])]).name
            what = f"CoM {outside:.2f} m outside its joints and geoms; expected at most {margin:.2f} m"
            yield model_fault(stance.robot, "body", heaviest, what)


def inertias_fit_the_masses(stance: Stance) -> Iterator[ConfigurationError]:
    """Check the inertias about the CoM, summed over the axes, against balls of tungsten and the robot's size."""
    mj, leg = stance.model.mj, stance.mean_leg_length
    mass, inertia = mj.body_mass, mj.body_inertia.sum(axis=1)
    least = POINT * 1.2 * mass * (3.0 * mass / (4.0 * np.pi * DENSEST)) ** (2 / 3)
    most = np.maximum(2.0 * mass * leg**2, SMALL * mass.sum() * leg**2)
    points = inertia < least
    if mass[points].sum() <= POINTS * mass.sum():
        points[:] = False
    for body in np.flatnonzero(points | (inertia > most)):
        what = f"inertia: got {inertia[body]:.3g} kg·m² in all for {mass[body]:.3g} kg"
        bounds = f"expected {least[body]:.2g} to {most[body]:.2g}"
        yield model_fault(stance.robot, "body", mj.body(body).name, f"{what}; {bounds}")


def _extent(mj: mujoco.MjModel, data: mujoco.MjData, root: int) -> tuple[FloatArray, FloatArray]:
    """Return lower and upper corner (3,) around a rigid body's frames, joints, sites and colliding geoms [m]."""
    joints, sites = mj.body_weldid[mj.jnt_bodyid] == root, mj.body_weldid[mj.site_bodyid] == root
    joints |= mj.body_weldid[mj.body_parentid[mj.jnt_bodyid]] == root
    geoms = mj.body_weldid[mj.geom_bodyid] == root
    points = [data.xpos[mj.body_weldid == root], data.xanchor[joints], data.site_xpos[sites]]
    radius = mj.geom_rbound[geoms, None]
    points += [data.geom_xpos[geoms] - radius, data.geom_xpos[geoms] + radius]
    every = np.concatenate(points)
    return every.min(axis=0), every.max(axis=0)


def friction_is_plausible(stance: Stance) -> Iterator[ConfigurationError]:
    """Check the sliding friction of geoms that collide; each wrong value once."""
    mj, (least, most) = stance.model.mj, FRICTION
    told = set[float]()
    for geom in range(mj.ngeom):
        friction = float(mj.geom_friction[geom, 0])
        if not least <= friction <= most and friction not in told:
            told.add(friction)
            name, body = mj.geom(geom).name, mj.body(mj.geom_bodyid[geom]).name
            what = f"got friction {friction:g}; expected {least:g} to {most:g}"
            yield model_fault(stance.robot, *(("geom", name) if name else ("body", body)), what)


def geoms_are_plausible(stance: Stance) -> Iterator[ConfigurationError]:
    """Check size, margin and contact parameters of geoms that collide."""
    mj, leg = stance.model.mj, stance.mean_leg_length
    for geom in range(mj.ngeom):
        body = int(mj.geom_bodyid[geom])
        radius, margin = float(mj.geom_rbound[geom]), float(mj.geom_margin[geom])
        radius += float(np.linalg.norm(stance.data.geom_xpos[geom] - stance.data.xpos[body]))
        across, box = stance.data.geom_xmat[geom].reshape(3, 3)[2], mj.geom_aabb[geom]
        lowest = float(stance.data.geom_xpos[geom, 2] + across @ box[:3] - np.abs(across) @ box[3:])
        (start, end, width), (time, ratio) = mj.geom_solimp[geom, :3].tolist(), mj.geom_solref[geom].tolist()
        what = ""
        if radius > LARGEST * leg:
            what = f"reaches {radius:.3g} m from its body; expected at most {LARGEST * leg:.3g} m"
        elif lowest < -BELOW * leg:
            what = (
                f"reaches {-lowest:.3g} m below the ground in the nominal posture; expected at most {BELOW * leg:.3g} m"
            )
        elif not 0.0 <= margin <= MARGIN * leg:
            what = f"got margin {margin:g}; expected 0 to {MARGIN * leg:.3g} m"
        elif not (0.0 <= start <= 1.0 and 0.0 <= end <= 1.0 and width >= 0.0 and (time > 0.0) == (ratio > 0.0)):
            what = f"got solimp {start:g} {end:g} {width:g}, solref {time:g} {ratio:g}; expected 0 to 1, one sign"
        if what:
            name = mj.geom(geom).name
            yield model_fault(stance.robot, *(("geom", name) if name else ("body", mj.body(body).name)), what)
