"""Creation of a robot's folder from its model."""

import re
from collections.abc import Callable
from itertools import product
from pathlib import Path

import mujoco
import numpy as np

from valor.robot.motion_tables import SelfCollision
from valor.robot.size import ESCHER
from valor.robot.tables import SIDES
from valor.robot_setup import model_xml
from valor.robot_setup.drives import Drive, find_drives, inertias, set_gains
from valor.robot_setup.geometry import ModelGeometry, Sole, fit_geometry, leg_length
from valor.robot_setup.posture import Chain, Poser, Stance
from valor.robot_setup.robot_yaml import RobotDraft, frames
from valor.robot_setup.skeleton import Skeleton, find_skeleton
from valor.robot_setup.source import Prompt, Question, Source, accept_guess

# Preset → position of the hand from its shoulder: forward, outward, up, in lengths of the arm.
PRESETS = {
    "home": (0.45, 0.25, -0.75),
    "forward": (0.8, 0.15, -0.2),
    "side": (0.15, 0.85, -0.1),
    "up": (0.35, 0.25, 0.75),
    "fold": (0.35, 0.15, -0.35),
}
GRAVITY = 9.81
STEPS = (0.001, 0.0005, 0.00025)  # of the physics [s]; from the second for legs below 0.4 m
GENERIC = ("model", "robot", "scene", "urdf", "mjcf")  # file names that do not name the robot
Sides = dict[str, dict[str, float]]  # side, joint → angle [rad]


def draft_robot(
    model: Path, name: str | None = None, ask: Prompt = accept_guess, report: Callable[[str], None] | None = None
) -> RobotDraft:
    """Determine the content of a robot's folder from its model, MJCF or URDF.

    ``ask`` answers questions about what the model leaves open; ``report`` receives the current stage. Raises
    ConfigurationError: the model cannot be read, is no humanoid with six joints per leg, or cannot stand.
    """
    report = report or (lambda stage: None)
    report(f"reading {model.name}")
    robot = find_skeleton(Source(model, ask))
    _free_frame_names(robot)
    name = name or ask(Question("name of the robot", _default_name(model)))
    report("measuring soles, hands and shapes")
    geometry = fit_geometry(robot)
    mass = float(sum(robot.source.mj.body_mass[body] for body in robot.edges))
    drives = find_drives(robot, leg_length(robot), mass * GRAVITY)
    mj = _compile(robot, geometry, name, drives)
    poser = Poser(mj)
    report("solving postures")
    stance, presets = _postures(robot, poser, geometry.soles)
    overlaps: set[tuple[str, str]] = set()
    for angles in (stance.angles, {}):
        poser.set_posture(angles)
        overlaps.update(poser.overlaps())
    geometry.excluded = sorted(pair for pair in overlaps if "world" not in pair)
    presets = _shorten(poser, presets, stance.angles, set(geometry.excluded))
    report("choosing bodies to keep apart")
    pairs = _pairs(robot, poser, geometry, stance, presets)
    poser.set_posture(stance.angles)
    mujoco.mj_forward(mj, poser.data)
    inertia, moment = inertias(robot, mj, poser.data), mass * GRAVITY * stance.com_height
    geometry.step = next(
        (step for step in STEPS[stance.leg_length < 0.4 :] if set_gains(drives, inertia, moment, step)), STEPS[-1]
    )
    passive = poser.solve_passive(stance.angles, _springs(robot))
    return RobotDraft(name, robot, geometry, drives, stance, mass, presets, pairs, passive)


def new_robot(model: Path, folder: Path, name: str) -> None:
    """Create a robot's folder from its model with all guesses; raises as ``draft_robot``."""
    draft = draft_robot(model, name)
    folder.mkdir(parents=True, exist_ok=True)
    draft.write(folder)


def _default_name(model: Path) -> str:
    """Return the file's name, or its folder's if the file's is generic."""
    name = model.stem if model.stem not in GENERIC else model.resolve().parent.name
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") or "robot"


def _free_frame_names(robot: Skeleton) -> None:
    """Rename bodies with the name of another frame."""
    names, reserved = robot.source.bodies, frames(robot) | {"imu": "imu"}
    for body, name in enumerate(names):
        if reserved.get(name, body) != body:
            names[body] = next(new for i in range(1, len(names) + 2) if (new := f"{name}_body{i}") not in names)
            robot.source.notes.append(f"body {name} is renamed to {names[body]}: {name} is the name of another frame")


def _compile(robot: Skeleton, geometry: ModelGeometry, name: str, drives: dict[int, Drive]) -> mujoco.MjModel:
    """Compile the generated model with the drives' armature and limits."""
    spec = mujoco.MjSpec.from_string(model_xml.render(robot, geometry, name))
    for joint, drive in drives.items():
        made = spec.joint(robot.joint_name(joint))
        made.armature = drive.armature
        made.range, made.limited = (drive.lower, drive.upper), mujoco.mjtLimited.mjLIMITED_TRUE
    try:
        return spec.compile()
    except ValueError as error:
        raise robot.source.fail(f"no model can be made of it: {' '.join(str(error).split())}") from None


def _springs(robot: Skeleton) -> dict[str, float]:
    """Return passive hinge → angle at which its spring is relaxed, or zero without a spring [rad]."""
    mj = robot.source.mj
    return {
        robot.joint_name(j): float(mj.qpos_spring[mj.jnt_qposadr[j]]) if mj.jnt_stiffness[j] else 0.0
        for j in robot.passive.hinges
    }


def _postures(robot: Skeleton, poser: Poser, soles: dict[str, Sole]) -> tuple[Stance, dict[str, Sides]]:
    """Return the nominal posture and the presets of the arms."""
    legs = {
        side: Chain(robot.joint_names(robot.legs[side].joints), f"{side[0]}_sole", (sole.heel + sole.toe) / 2)
        for side, sole in soles.items()
    }
    half_width = max(sole.half_width for sole in soles.values())
    arms = {side: Chain(robot.joint_names(arm.joints), f"{side[0]}_gripper") for side, arm in robot.arms.items()}
    limits = {name: poser.limits(name) for name in robot.joint_names(sorted(robot.driven))}
    rest = {
        name: float(np.clip(0.0, *poser.bounds([name]))[0])
        for name, (low, high) in limits.items()
        if not low <= 0.0 <= high
    }
    passive = poser.solve_passive(rest, _springs(robot))
    rest |= passive
    presets: dict[str, Sides] = {}
    for preset, (ahead, outward, up) in PRESETS.items() if arms else ():
        directions = {side: np.array([ahead, outward if side == "left" else -outward, up]) for side in arms}
        presets[preset] = {side: poser.solve_reach(arm, directions[side], rest) for side, arm in arms.items()}
    stance = poser.solve_stance(legs, half_width, rest | _merged(presets.get("home", {})))
    stance.angles = {name: angle for name, angle in stance.angles.items() if name not in passive}
    return stance, presets


def _merged(sides: Sides) -> dict[str, float]:
    return {name: angle for angles in sides.values() for name, angle in angles.items()}


def _shorten(
    poser: Poser, presets: dict[str, Sides], standing: dict[str, float], excluded: set[tuple[str, str]]
) -> dict[str, Sides]:
    """Shorten presets towards ``home`` until both arms touch nothing; drop those that always touch."""
    found: dict[str, Sides] = {}
    for preset, sides in presets.items():
        for ratio in (1.0, 0.8, 0.6, 0.4, 0.2):
            blended: Sides = {}
            for side, angles in sides.items():
                home = presets["home"][side]
                blended[side] = {name: round(home[name] + ratio * (a - home[name]), 3) for name, a in angles.items()}
            poser.set_posture(standing | _merged(blended))
            if not set(poser.overlaps()) - excluded:
                found[preset] = blended
                break
    return found


def _pairs(
    robot: Skeleton, poser: Poser, geometry: ModelGeometry, stance: Stance, presets: dict[str, Sides]
) -> list[tuple[str, str]]:
    """Return the pairs kept apart: between legs, arms, and outer arm and trunk or thigh, if they are apart at rest."""
    shapes = [robot.name(body) for body in geometry.capsules]

    def along(joints: list[int]) -> list[str]:
        bodies = {int(poser.mj.joint(robot.joint_name(j)).bodyid[0]) for j in joints}
        return [name for name in shapes if poser.mj.body(name).id in bodies]

    legs = {side: along(robot.legs[side].joints[2:]) for side in SIDES}
    pairs = [*product(legs["left"], legs["right"])]
    trunk = [robot.name(b) for b in (robot.chest, robot.pelvis, robot.head) if b is not None and b in geometry.capsules]
    outer = {side: along(arm.joints[len(arm.joints) // 2 :]) for side, arm in robot.arms.items()}
    for side, arm in outer.items():
        pairs += product(arm, dict.fromkeys([*trunk, *legs[side][:2]]))
    if outer:
        pairs += product(outer["left"], outer["right"])
    near = SelfCollision().near * stance.leg_length / ESCHER.leg
    found = []
    for pair in pairs:
        distances = []
        for angles in ({}, *map(_merged, presets.values())):
            poser.set_posture(stance.angles | angles)
            distances.append(_distance(poser, *pair))
        if distances[0] > 1.05 * near and min(distances) > 0.5 * near:
            found.append(pair)
    return found


def _distance(poser: Poser, *bodies: str) -> float:
    """Return the distance of the largest colliding geoms of two bodies [m], at most 1."""
    mj = poser.mj
    collide = (mj.geom_contype != 0) | (mj.geom_conaffinity != 0)
    geoms = []
    for name in bodies:
        own = np.flatnonzero((mj.geom_bodyid == mj.body(name).id) & collide)
        geoms.append(int(own[np.argmax(mj.geom_rbound[own])]))
    return float(mujoco.mj_geomDistance(mj, poser.data, *geoms, 1.0, None))
