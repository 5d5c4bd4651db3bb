"""Plan of a manipulation: a stance, and goals of the right hand, from its shape and the length of its arm."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Self

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.errors import ValorError
from valor.common.poses import Pose, level
from valor.common.rotation import Vector
from valor.robot.description import RobotDescription
from valor.robot.model import Model, full_model
from valor.robot.step_plan import Middle

REACHED, RESISTED = "reached", "resisted"  # states of HandGoalStatus
PATIENCE = 8.0  # timeout of a retreat [robot time, s]
STRETCH = 0.97  # distance of a goal from the shoulder, at most, share of the arm's length


@dataclass(frozen=True)
class HandShape:
    """Right hand with its fingers at a preset, in the frame of its site: x forward, y left, z up."""

    robot: str  # its name
    front: float  # of the foremost finger [m]
    bottom: float  # of the palm's lower edge; negative [m]
    middle: float  # y of the palm's middle [m]
    half_width: float  # of the palm along y [m]
    shoulder: Vector  # (3,) in the frame of the middle of the feet, in the nominal posture [m]
    arm: float  # length, shoulder to site [m]

    @classmethod
    def of(cls, robot: RobotDescription, task: str, fingers: str) -> Self:
        """Shape of a robot's hand; ``ValorError`` if footsteps, a right hand on an arm, or the preset is missing."""
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
    """(k, 3) corners of the bounding boxes of the bodies, in the site's frame."""
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
    mj = model.mj
    carriers = sorted(int(mj.joint(joint).bodyid[0]) for joint in robot.tables.group("right_arm"))
    first = carriers[min(1, len(carriers) - 1)]
    body, places = int(mj.site_bodyid[site]), [data.site_xpos[site]]
    while body >= first:
        places.append(data.xpos[body])
        body = int(mj.body_parentid[body])
    return first, float(sum(np.linalg.norm(a - b) for a, b in pairwise(places)))


@dataclass(frozen=True)
class HandMove:
    """A goal of the hand."""

    name: str
    hand: Pose  # of its site in odom
    patience: float  # timeout, after which the next goal is sent [robot time, s]


@dataclass(frozen=True)
class Plan:
    """Stance, fingers and goals."""

    stance: Middle  # middle of the feet in odom, x, y [m], yaw [rad]
    fingers: str  # preset of the hand
    moves: Sequence[HandMove]  # goals of the right hand, in order
    out: Vector  # displacement of a retreat in odom [m]
    resisted: str  # meaning of a resisted goal

    def retreat(self, move: HandMove) -> tuple[HandMove, HandMove]:
        """Goals of a retreat: back to a reached goal, and straight out."""
        x, y, z = (place + out for place, out in zip(move.hand.position, self.out, strict=True))
        away = Pose((x, y, z), move.hand.orientation)
        return HandMove("back", move.hand, PATIENCE), HandMove("off", away, PATIENCE)


def require_reach(task: str, plan: Plan, hand: HandShape) -> None:
    """Raise ``ValorError`` if the arm is too short for a goal."""
    x, y, yaw = plan.stance
    shoulder = (level(x, y, 0.0, yaw) @ Pose(hand.shoulder)).position
    far, name = max((math.dist(shoulder, move.hand.position), move.name) for move in plan.moves)
    if far > STRETCH * hand.arm:
        raise ValorError(
            f"{task}: the right arm of {hand.robot!r} is {hand.arm:.2f} m long; expected at least {far / STRETCH:.2f} "
            f"m, for {name!r} is {far:.2f} m from its shoulder"
        )
