"""How far a robot's left side is from the mirror image of its right one: no model from CAD is it to the last digit.

Both sides' groups name twins in the same order. A posture and its mirror image are compared, for a few postures.
"""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from valor.robot.checks import SIDES, Stance

PLACE = 0.005  # of the straight leg: twins that are mirrored so well are told of no difference
MASS = 0.01  # of the heavier twin's mass, likewise
_MIRROR = np.array([1.0, -1.0, 1.0])
_POSTURES, _ANGLE = 4, 0.5  # how many, and how far from nominal [rad]


def twins(stance: Stance) -> list[tuple[str, str]]:
    """Joints of the left side, and those of the right that are in their places."""
    tables = stance.robot.tables
    return [
        pair
        for limb in ("leg", "arm", "hand")
        for pair in zip(*(tables.group(f"{side}_{limb}") for side in SIDES), strict=False)
    ]


def asymmetries(stance: Stance, place: float = PLACE, mass: float = MASS) -> Iterator[str]:
    """What of the two sides differs, a line each.

    Args:
        stance: the robot.
        place: difference of places from which one is told of, of the leg's length.
        mass: likewise of the masses that joints move, of the heavier.
    """
    tables, model = stance.robot.tables, stance.model
    pairs = twins(stance)
    for side in SIDES:
        for limb in ("leg", "arm", "hand"):
            count, others = (len(tables.group(f"{each}_{limb}")) for each in (side, _other(side)))
            if count > others:
                yield f"the {side} {limb} has {count} joints, the other {others}"
    masses = {name: float(model.mj.body_subtreemass[model.mj.joint(name).bodyid[0]]) for pair in pairs for name in pair}
    apart = _places(stance, pairs)
    leg = stance.leg_length("left")
    for one, other in pairs:
        if (distance := apart[one]) > place * leg:
            yield f"{one} and {other} are {1e3 * distance:.1f} mm from each other's mirror images"
        if abs(masses[one] - masses[other]) > mass * max(masses[one], masses[other]):
            yield f"{one} moves {masses[one]:.3f} kg, {other} {masses[other]:.3f} kg"
        for field in ("velocity", "effort", "control"):
            left, right = (getattr(tables.joints[name], field) for name in (one, other))
            if left != right:
                yield f"{field} of {one} is {left}, of {other} {right}"


def _other(side: str) -> str:
    return SIDES[1 - SIDES.index(side)]


def _places(stance: Stance, pairs: list[tuple[str, str]]) -> dict[str, float]:
    """Left joint → greatest distance from its twin's mirror image, of anchors and of what hangs there."""
    mj, robot, data = stance.model.mj, stance.robot, mujoco.MjData(stance.model.mj)
    seen: dict[str, float] = {one: 0.0 for one, _ in pairs}
    rng = np.random.default_rng(0)
    signs = {one: _sign(stance, one, other) for one, other in pairs}
    for _ in range(_POSTURES):
        found = []
        angles = {one: rng.uniform(-_ANGLE, _ANGLE) for one, _ in pairs}
        for mirrored in (False, True):
            data.qpos[:] = mj.qpos0
            data.qpos[3:7] = (1.0, 0.0, 0.0, 0.0)
            for one, other in pairs:
                name = other if mirrored else one
                data.qpos[mj.joint(name).qposadr[0]] = angles[one] * (signs[one] if mirrored else 1.0)
            mujoco.mj_fwdPosition(mj, data)
            base = data.xpos[stance.model.body(robot.tables.base)]
            names = [pair[1 if mirrored else 0] for pair in pairs]
            flip = _MIRROR if mirrored else 1.0
            bodies = [int(mj.joint(name).bodyid[0]) for name in names]
            anchors = [(data.joint(name).xanchor - base) * flip for name in names]
            found.append(
                [np.stack([a, (data.subtree_com[b] - base) * flip]) for a, b in zip(anchors, bodies, strict=True)]
            )
        for (one, _), left, right in zip(pairs, *found, strict=True):
            seen[one] = max(seen[one], float(np.linalg.norm(left - right, axis=1).max()))
    return seen


def _sign(stance: Stance, one: str, other: str) -> float:
    """1 where twins turn by the same angle in mirrored postures, −1 where by opposite ones."""
    mj = stance.model.mj
    data = mujoco.MjData(mj)
    data.qpos[:] = mj.qpos0
    mujoco.mj_kinematics(mj, data)
    left, right = (data.joint(name).xaxis for name in (one, other))
    return 1.0 if float((left * -_MIRROR) @ right) > 0 else -1.0
