"""Make a robot's folder of its model."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.robot.checks import SIDES
from valor.robot.motion_tables import SelfCollision
from valor.robot.size import ESCHER
from valor.robot_setup import model_xml, robot_yaml
from valor.robot_setup.drives import Drive, drives, inertias, tune
from valor.robot_setup.geometry import Sole, cloud, sole
from valor.robot_setup.posture import Chain, Poser, Stance
from valor.robot_setup.questions import Ask, Question, Tell, guess, silent
from valor.robot_setup.skeleton import Skeleton, skeleton
from valor.robot_setup.source import Source

# Preset → where the hand goes from its shoulder: forward, outward, up, in lengths of the arm.
PRESETS = {
    "home": (0.45, 0.25, -0.75),
    "forward": (0.8, 0.15, -0.2),
    "side": (0.15, 0.85, -0.1),
    "up": (0.35, 0.25, 0.75),
    "fold": (0.35, 0.15, -0.35),
}
GRAVITY = 9.81
GROUND = 0.02  # of a leg: parts of a foot whose undersides are so near in height all stand on the ground
GENERIC = ("model", "robot", "scene", "urdf", "mjcf")  # names of files that say nothing of the robot
Presets = dict[str, dict[str, dict[str, float]]]  # preset, side, joint → angle [rad]


@dataclass
class Study:
    """A robot as it was found in its model, and all that was solved for it; nothing is written yet."""

    content: robot_yaml.Content
    parts: model_xml.Parts

    def write(self, folder: Path) -> None:
        """Write ``model.xml``, ``robot.yaml`` and meshes into a folder that there is."""
        model_xml.write(self.content.robot, self.parts, self.content.name, folder, self.content.stance.leg_length)
        (folder / "robot.yaml").write_text(robot_yaml.text(self.content), encoding="utf-8")


def study(model: Path, name: str | None = None, ask: Ask = guess, tell: Tell = silent) -> Study:
    """Find out all that a robot's folder says.

    Args:
        model: MJCF or URDF.
        name: of the robot; None: asked for.
        ask: for what cannot be known.
        tell: what is being done.

    Raises:
        ConfigurationError: the model cannot be read, is no humanoid with six joints a leg, or cannot stand.
    """
    tell(f"reading {model.name}")
    robot = skeleton(Source(model), ask)
    _keep_frames_free(robot)
    name = name or ask(Question("name of the robot", _usual_name(model)))
    _find_ends(robot)
    tell("measuring soles, hands and shapes")
    soles = {side: _sole(robot, side) for side in SIDES}
    palms = {side: _palm(robot, side) for side in robot.arms}
    parts = model_xml.fit(robot, soles, palms)
    mass = float(sum(robot.source.mj.body_mass[body] for body in robot.edges))
    found = drives(robot, _leg_length(robot), mass * GRAVITY)
    limits = {robot.joint_name(j): (d.lower, d.upper) for j, d in found.items()}
    mj = _compiled(robot, parts, name, found)
    poser = Poser(mj, limits)
    tell("having it stand")
    stance, presets = _postures(robot, poser, limits, soles)
    parts.excluded = _overlapping(poser, stance.angles)
    presets = _free(poser, presets, stance.angles, set(parts.excluded)) if presets else {}
    tell("keeping limbs apart")
    pairs = _pairs(robot, poser, parts, stance, presets)
    parts.step = 0.001 if stance.leg_length > 0.4 else 0.0005
    poser.put(stance.angles)
    mujoco.mj_forward(mj, poser.data)
    tune(found, inertias(robot, mj, poser.data), mass * GRAVITY * stance.com_height, parts.step)
    passive = poser.rest(stance.angles, _springs(robot))
    content = robot_yaml.Content(name, robot, soles, found, stance, mass, presets, pairs, parts.step, passive)
    return Study(content, parts)


def new_robot(model: Path, folder: Path, name: str) -> Skeleton:
    """Write a robot's folder out of its model, and ask nobody.

    Raises:
        ConfigurationError: as ``study``.
    """
    found = study(model, name)
    folder.mkdir(parents=True, exist_ok=True)
    found.write(folder)
    return found.content.robot


def _usual_name(model: Path) -> str:
    """The file's; its folder's where that says nothing."""
    told = model.stem if model.stem not in GENERIC else model.resolve().parent.name
    return re.sub(r"[^a-z0-9]+", "_", told.lower()).strip("_") or "robot"


def _postures(
    robot: Skeleton, poser: Poser, limits: dict[str, tuple[float, float]], soles: dict[str, Sole]
) -> tuple[Stance, Presets]:
    """How it stands, and its arms' presets."""
    legs = {
        side: Chain(
            tuple(map(robot.joint_name, robot.legs[side].joints)), f"{side[0]}_sole", (each.heel + each.toe) / 2
        )
        for side, each in soles.items()
    }
    half_width = max(each.half_width for each in soles.values())
    arms = {
        side: Chain(tuple(map(robot.joint_name, limb.joints)), f"{side[0]}_gripper")
        for side, limb in robot.arms.items()
    }
    rest = _within({}, limits)
    passive = poser.rest(rest, _springs(robot))
    rest |= passive
    presets = {
        preset: {side: poser.reach(arm, _outward(way, side), rest) for side, arm in arms.items()}
        for preset, way in PRESETS.items()
        if arms
    }
    home = {name: angle for side in presets.get("home", {}).values() for name, angle in side.items()}
    stance = poser.stand(legs, half_width, rest | home)
    stance.angles = {name: angle for name, angle in stance.angles.items() if name not in passive}
    return stance, presets


def _keep_frames_free(robot: Skeleton) -> None:
    """Rename bodies that are called like frames of others."""
    names, wanted = robot.source.bodies, robot_yaml.frames(robot) | {"imu": "imu"}
    for body, name in enumerate(names):
        if wanted.get(name, body) != body:
            names[body] = next(new for i in range(1, len(names) + 2) if (new := f"{name}_body{i}") not in names)
            robot.source.notes.append(f"body {name} is called {names[body]}: the frame {name} is another")


def _springs(robot: Skeleton) -> dict[str, float]:
    """Of hinges that nothing drives, where their springs are, or else their zeros [rad]."""
    mj = robot.source.mj
    return {
        robot.joint_name(j): float(mj.qpos_spring[mj.jnt_qposadr[j]]) if mj.jnt_stiffness[j] else 0.0
        for j in robot.passive.hinges
    }


def _find_ends(robot: Skeleton) -> None:
    """Where a passive hinge divides a hand, the part at the wrist.

    And of a foot that which carries: the longest of those that reach lowest.
    """
    source = robot.source
    for arm in robot.arms.values():
        wrist = int(source.mj.jnt_bodyid[arm.joints[-1]])
        if wrist in model_xml.link(robot, arm.end):
            arm.end = max(model_xml.rigid(robot, wrist), key=lambda body: float(source.mj.body_mass[body]))
    for leg in robot.legs.values():
        parts = {tuple(model_xml.rigid(robot, body)) for body in model_xml.link(robot, leg.end)}
        ankle = source.data.xanchor[leg.joints[-1]]
        soles = {part: sole(cloud(source, part), ankle, robot.forward) for part in sorted(parts)}
        found = {part: each for part, each in soles.items() if each is not None}
        if len(parts) < 2 or not found:
            continue
        lowest = min(float(each.origin @ robot.forward[:, 2]) for each in found.values())
        near = GROUND * _leg_length(robot)
        low = [part for part, each in found.items() if float(each.origin @ robot.forward[:, 2]) < lowest + near]
        part = max(low, key=lambda each: found[each].toe - found[each].heel)
        leg.end = max(part, key=lambda body: float(source.mj.body_mass[body]))


def _sole(robot: Skeleton, side: str) -> Sole:
    leg, source = robot.legs[side], robot.source
    found = sole(cloud(source, model_xml.rigid(robot, leg.end)), source.data.xanchor[leg.joints[-1]], robot.forward)
    if found is None:
        raise ConfigurationError(
            f"{source.file}: body {robot.name(leg.end)}: no flat underside found; expected geoms to stand on"
        )
    return found


def _palm(robot: Skeleton, side: str) -> FloatArray:
    """Where a hand holds: two thirds of the way from its joint to its far end, as drawn."""
    limb, source = robot.arms[side], robot.source
    wrist = source.data.xanchor[limb.joints[-1]]
    points = cloud(source, model_xml.link(robot, limb.end))
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


def _leg_length(robot: Skeleton) -> float:
    """About: the joints' anchors of a leg, as drawn [m]."""
    anchors = robot.source.data.xanchor[robot.legs["left"].joints]
    return float(np.linalg.norm(np.diff(anchors, axis=0), axis=1).sum())


def _compiled(robot: Skeleton, parts: model_xml.Parts, name: str, found: dict[int, Drive]) -> mujoco.MjModel:
    """The generated model with the drives' armature."""
    spec = mujoco.MjSpec.from_string(model_xml.text(robot, parts, name))
    for joint, drive in found.items():
        own = spec.joint(robot.joint_name(joint))
        own.armature = drive.armature
        own.range, own.limited = (drive.lower, drive.upper), mujoco.mjtLimited.mjLIMITED_TRUE
    return spec.compile()


def _within(angles: dict[str, float], limits: dict[str, tuple[float, float]]) -> dict[str, float]:
    """All joints at zero, or as near to it as they go."""
    return {
        name: float(np.clip(angles.get(name, 0.0), low, high))
        for name, (low, high) in limits.items()
        if not low <= 0.0 <= high
    }


def _outward(way: tuple[float, float, float], side: str) -> FloatArray:
    return np.array([way[0], way[1] if side == "left" else -way[1], way[2]])


def _overlapping(poser: Poser, legs: dict[str, float]) -> list[tuple[str, str]]:
    """What overlaps standing, and in the configuration of zeros."""
    pairs: set[tuple[str, str]] = set()
    for angles in (legs, {}):
        poser.put(angles)
        pairs |= set(poser.touching())
    return sorted(pair for pair in pairs if "world" not in pair)


def _free(
    poser: Poser,
    presets: Presets,
    standing: dict[str, float],
    excluded: set[tuple[str, str]],
) -> Presets:
    """Presets as far from home as they go without touching, both arms at once."""
    home, kept = presets["home"], {}
    for preset, sides in presets.items():
        for share in (1.0, 0.8, 0.6, 0.4, 0.2):
            blended = {
                side: {
                    name: round(home[side][name] + share * (angle - home[side][name]), 3)
                    for name, angle in angles.items()
                }
                for side, angles in sides.items()
            }
            poser.put(standing | {name: angle for angles in blended.values() for name, angle in angles.items()})
            if not set(poser.touching()) - excluded:
                kept[preset] = blended
                break
    return kept


def _pairs(
    robot: Skeleton,
    poser: Poser,
    parts: model_xml.Parts,
    stance: Stance,
    presets: Presets,
) -> list[tuple[str, str]]:
    """What shall not touch: legs each other, the outer arms the trunk, the thighs and each other."""
    named = {body: robot.name(body) for body in parts.capsules}

    def along(joints: list[int]) -> list[int]:
        return [body for body in parts.capsules if any(name in own[body] for name in map(robot.joint_name, joints))]

    own = {
        body: {poser.mj.joint(j).name for j in range(poser.mj.njnt) if poser.mj.jnt_bodyid[j] == poser.mj.body(name).id}
        for body, name in named.items()
    }
    legs = {side: along(robot.legs[side].joints[2:]) for side in SIDES}
    pairs = [*product(legs["left"], legs["right"])]
    trunk = [body for body in (robot.chest, robot.pelvis, robot.head) if body in parts.capsules]
    outer = {side: along(limb.joints[len(limb.joints) // 2 :]) for side, limb in robot.arms.items()}
    for side, arm in outer.items():
        pairs += product(arm, dict.fromkeys([*trunk, *legs[side][:2]]))
    if outer:
        pairs += product(outer["left"], outer["right"])
    near = SelfCollision().near * stance.leg_length / ESCHER.leg
    kept = []
    for one, other in pairs:
        distances = []
        for angles in (
            {},
            *({name: a for side in sides.values() for name, a in side.items()} for sides in presets.values()),
        ):
            poser.put(stance.angles | angles)
            distances.append(_distance(poser, named[one], named[other]))
        if distances[0] > 1.05 * near and min(distances) > 0.5 * near:
            kept.append((named[one], named[other]))
    return kept


def _distance(poser: Poser, one: str, other: str) -> float:
    mj = poser.mj
    geoms = []
    for name in (one, other):
        mine = [
            g
            for g in range(mj.ngeom)
            if mj.geom_bodyid[g] == mj.body(name).id and (mj.geom_contype[g] or mj.geom_conaffinity[g])
        ]
        geoms.append(max(mine, key=lambda g: float(mj.geom_rbound[g])))
    return float(mujoco.mj_geomDistance(mj, poser.data, geoms[0], geoms[1], 1.0, None))
