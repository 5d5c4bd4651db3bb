"""How large a hand is, as seen from its site, and where its arm begins."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise, product
from typing import Self

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.errors import ValorError
from valor.common.rotation import Vector
from valor.robot.description import RobotDescription
from valor.robot.model import Model, full_model


@dataclass(frozen=True)
class HandShape:
    """The right hand with its fingers as a preset has them; x ahead, y left, z up in its site's frame.

    Attributes:
        robot: its name.
        front: of the foremost finger [m].
        bottom: of the palm's lower edge; negative [m].
        middle: y of the palm's middle [m].
        half_width: of the palm along y [m].
        shoulder: (3,) in the frame of the middle of the feet, in the nominal posture [m].
        arm: length, shoulder to site [m].
    """

    robot: str
    front: float
    bottom: float
    middle: float
    half_width: float
    shoulder: Vector
    arm: float

    @classmethod
    def of(cls, robot: RobotDescription, task: str, fingers: str) -> Self:
        """Of a robot that has what a task needs.

        Raises:
            ValorError: it lacks steps, a right hand on an arm, or the fingers' preset; names it.
        """
        hand, presets = robot.tables.hands.right, robot.tables.hand_presets.get(fingers, {})
        if robot.tables.footsteps is None:
            raise ValorError(f"{task}: robot {robot.name!r} takes no footstep plans: its robot.yaml has no footsteps")
        if hand is None or not robot.tables.group("right_arm"):
            raise ValorError(f"{task}: robot {robot.name!r} has no right hand on an arm; expected one")
        if "right" not in presets:
            raise ValorError(f"{task}: robot {robot.name!r} has no preset {fingers!r} of its right hand; expected one")
        model = full_model(robot, "collision")
        data = mujoco.MjData(model.mj)
        data.qpos[:] = model.nominal_qpos()
        for joint, angle in presets["right"].items():
            data.qpos[model.mj.joint(joint).qposadr[0]] = angle
        mujoco.mj_kinematics(model.mj, data)
        top, site = model.body(hand.body), model.site(hand.site)
        palm = _corners(model, data, site, [top])
        whole = _corners(model, data, site, _below(model.mj, top))
        first, length = _arm(model, robot, data, site)
        feet = (robot.tables.feet.left, robot.tables.feet.right)
        middle = np.mean([data.site_xpos[model.site(foot.sole)] for foot in feet], axis=0)
        x, y, z = map(float, data.xpos[first] - middle)
        return cls(
            robot.name,
            front=float(whole[:, 0].max()),
            bottom=float(palm[:, 2].min()),
            middle=float((palm[:, 1].min() + palm[:, 1].max()) / 2),
            half_width=float(np.ptp(palm[:, 1]) / 2),
            shoulder=(x, y, z),
            arm=length,
        )


def _corners(model: Model, data: mujoco.MjData, site: int, bodies: list[int]) -> FloatArray:
    """(k, 3) of the boxes about the bodies' shapes, in the site's frame."""
    mj, found = model.mj, list[FloatArray]()
    for geom in np.flatnonzero(np.isin(mj.geom_bodyid, bodies)):
        centre, half = mj.geom_aabb[geom, :3], mj.geom_aabb[geom, 3:]
        corners = centre + half * np.array(list(product((-1, 1), repeat=3)))
        in_world = data.geom_xpos[geom] + corners @ data.geom_xmat[geom].reshape(3, 3).T
        found.append((in_world - data.site_xpos[site]) @ data.site_xmat[site].reshape(3, 3))
    if not found:
        raise ValorError(f"robot {model.robot.name!r}: its right hand has no shape that touches; expected one")
    return np.concatenate(found)


def _below(mj: mujoco.MjModel, top: int) -> list[int]:
    bodies = [top]
    for body in range(top + 1, mj.nbody):
        if mj.body_parentid[body] in bodies:
            bodies.append(body)
    return bodies


def _arm(model: Model, robot: RobotDescription, data: mujoco.MjData, site: int) -> tuple[int, float]:
    """The body that the arm hangs from, behind the first joint, which lies inside the shoulder; the arm's length."""
    mj = model.mj
    carriers = sorted(int(mj.joint(joint).bodyid[0]) for joint in robot.tables.group("right_arm"))
    first = carriers[min(1, len(carriers) - 1)]
    body, places = int(mj.site_bodyid[site]), [data.site_xpos[site]]
    while body >= first:
        places.append(data.xpos[body])
        body = int(mj.body_parentid[body])
    return first, float(sum(np.linalg.norm(a - b) for a, b in pairwise(places)))
