"""All faults of a robot's folder, found before any process starts; checks that need a broken key are skipped."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from msgspec import structs

from valor.common.errors import ConfigurationError, SeveralFaultsError
from valor.common.table import TableError
from valor.robot import get_up_table
from valor.robot.checks import drives, geometry, physics, tables
from valor.robot.checks.stance import Stance
from valor.robot.description import RobotDescription, read_tables
from valor.robot.model import controller_model
from valor.robot.tables import SIDES, RobotTables

SHOWN_ASYMMETRIES = 6
ASYMMETRY = 0.005  # least reported difference of positions, relative to the straight leg
MASS_ASYMMETRY = 0.01  # least reported difference of moved masses, relative to the larger one
_MIRROR = np.array([1.0, -1.0, 1.0])
_POSTURES, _ANGLE = 4, 0.5  # number of postures for them; largest angle from nominal [rad]


class Check(NamedTuple):
    """Check of the robot in its nominal posture, and the keys of robot.yaml that it depends on."""

    find: Callable[[Stance], Iterator[TableError] | Iterator[ConfigurationError]]
    depends_on: tuple[str, ...] = ()


CHECKS: tuple[Check, ...] = (
    Check(geometry.sites_are_on_their_bodies),
    Check(geometry.imu_is_near_the_base, ("groups", "imu")),
    Check(geometry.torso_is_below_the_chest, ("groups", "chest")),
    Check(geometry.limbs_are_on_their_sides, ("feet", "hands", "chest")),
    Check(geometry.groups_match_their_limbs, ("groups", "feet", "hands", "chest")),
    Check(geometry.soles_stand_on_the_ground, ("feet", "nominal_posture")),
    Check(geometry.soles_lie_on_their_geoms, ("feet",)),
    Check(geometry.soles_are_as_large_as_the_feet, ("feet",)),
    Check(geometry.feet_stand_apart, ("feet", "nominal_posture", "footsteps")),
    Check(geometry.com_is_over_the_soles, ("feet", "nominal_posture")),
    Check(geometry.couplings_hold, ("passive", "nominal_posture")),
    Check(geometry.nothing_touches, ("nominal_posture",)),
    Check(geometry.arm_presets_touch_nothing, ("nominal_posture", "arm_presets")),
    Check(geometry.pairs_are_kept_apart, ("nominal_posture",)),
    Check(geometry.size_matches_the_model, ("size", "groups")),
    Check(geometry.walking_matches_the_legs, ("groups", "nominal_posture", "walking")),
    Check(drives.joints_can_carry_the_robot, ("groups", "feet", "nominal_posture", "nominal_base_height")),
    Check(drives.servos_hold_the_robot_up, ("groups", "nominal_posture")),
    Check(drives.efforts_move_the_joints),
    Check(drives.legs_are_fast_enough, ("groups", "walking")),
    Check(drives.servos_are_damped),
    Check(drives.servos_suit_the_physics_step, ("nominal_posture",)),
    Check(physics.masses_fit_their_bodies, ("groups",)),
    Check(physics.inertias_fit_the_masses, ("groups",)),
    Check(physics.friction_is_plausible),
    Check(physics.geoms_are_plausible, ("groups",)),
)


@dataclass
class Findings:
    """Result of ``examine`` of a folder."""

    folder: Path
    robot: RobotDescription | None = None  # None if robot.yaml cannot be read
    faults: list[ConfigurationError] = field(default_factory=list)  # one each, with file, line and key
    unchecked: list[str] = field(default_factory=list)  # lines that name skipped checks, with the reason
    broken: set[str] = field(default_factory=set)  # first keys of the faults in robot.yaml

    def require_none(self) -> RobotDescription:
        """Return the robot. Raises ConfigurationError: a line for each fault."""
        if self.faults or self.unchecked:
            again = f"{self.folder}: correct the above, then run `valorctl robot check {self.folder}`"
            raise SeveralFaultsError(self.faults, [*self.unchecked, again])
        assert self.robot is not None
        return self.robot

    def tried(self, step: Callable[[], object]) -> bool:
        """Call a function and store its ``ConfigurationError``; return whether it raised none."""
        try:
            step()
        except ConfigurationError as error:
            self.faults += SeveralFaultsError.each(error)
            return False
        return True

    def add(self, robot: RobotDescription, found: Iterable[TableError | ConfigurationError]) -> None:
        """Store faults of robot.yaml, and of other files."""
        for each in found:
            if isinstance(each, ConfigurationError):
                self.faults.append(each)
                continue
            self.faults.append(robot.error(each.path, each.what))
            self.broken.update(each.path[:1])

    def notes(self) -> list[str]:
        """Return remarks about a robot without faults: passive joints, and differences of its two sides."""
        if self.robot is None or self.faults:
            return []
        differences = list(asymmetries(Stance(self.robot)))
        hidden = len(differences) - SHOWN_ASYMMETRIES
        more = [f"and {hidden} more differences"] if hidden > 0 else []
        return [*_passive_joints(self.robot), *differences[:SHOWN_ASYMMETRIES], *more]


def _passive_joints(robot: RobotDescription) -> list[str]:
    kinds = {"simulated, fixed for controllers": True, "welded": False}
    named = {kind: [n for n, each in robot.tables.passive.items() if each.simulated is m] for kind, m in kinds.items()}
    return [f"passive joints, {kind}: {', '.join(names)}" for kind, names in named.items() if names]


def examine(
    folder: Path,
    control_rate: float | None = None,
    more: Iterable[Callable[[RobotDescription], Iterator[TableError]]] = (),
) -> Findings:
    """Check a robot's folder, with another control rate [Hz] than robot.yaml's.

    ``more``: checks of sections that other packages read; they may raise ``ConfigurationError``.
    """
    findings, file = Findings(folder), folder / "robot.yaml"
    if not file.is_file():
        findings.faults.append(ConfigurationError(f"{file}: no such file; expected a robot's folder with robot.yaml"))
        return findings
    read: list[RobotTables] = []
    if not findings.tried(lambda: read.append(read_tables(file))):
        findings.unchecked.append(f"{file}: not checked until it can be read: consistency of its keys")
        return findings
    rate = read[0].control_rate if control_rate is None else control_rate
    robot = findings.robot = RobotDescription(folder, structs.replace(read[0], control_rate=rate), checked=False)
    findings.add(robot, tables.violations(robot.tables))
    for check in more:
        findings.tried(lambda check=check: findings.add(robot, check(robot)))  # type: ignore[misc]
    findings.tried(lambda: get_up_table.load(robot))
    if control_rate is None:  # the caller is responsible for another rate
        findings.tried(robot.physics_steps)
    if robot.model_file.is_file():
        _examine_model(findings, robot)
    else:
        findings.faults.append(robot.error(["model"], f"no file {robot.model_file}"))
    return findings


def _examine_model(findings: Findings, robot: RobotDescription) -> None:
    stances: list[Stance] = []
    if not findings.tried(lambda: stances.append(Stance(robot))):
        findings.unchecked.append(f"{robot.model_file}: not checked until it compiles: sides, soles, postures, drives")
        return
    findings.tried(lambda: controller_model(robot))
    skipped: dict[str, list[str]] = {}
    for check in CHECKS:
        if broken := findings.broken.intersection(check.depends_on):
            skipped.setdefault(", ".join(sorted(broken)), []).append(check.find.__name__.replace("_", " "))
        else:
            findings.add(robot, list(check.find(stances[0])))
    for keys, names in skipped.items():
        findings.unchecked.append(f"{robot.file}: not checked until {keys} is right: {'; '.join(names)}")


def asymmetries(stance: Stance, position: float = ASYMMETRY, mass: float = MASS_ASYMMETRY) -> Iterator[str]:
    """Yield the differences of the left side and the mirror image of the right one, in a few random postures."""
    table, model = stance.robot.tables, stance.model
    pairs = [
        pair
        for limb in ("leg", "arm", "hand")
        for pair in zip(*(table.group(f"{side}_{limb}") for side in SIDES), strict=False)
    ]
    for side, other_side in (SIDES, SIDES[::-1]):
        for limb in ("leg", "arm", "hand"):
            count, others = (len(table.group(f"{each}_{limb}")) for each in (side, other_side))
            if count > others:
                yield f"the {side} {limb} has {count} joints, the other {others}"
    masses = {name: float(model.mj.body_subtreemass[model.mj.joint(name).bodyid[0]]) for pair in pairs for name in pair}
    leg = stance.leg_length("left")
    for (one, other), distance in zip(pairs, _distances(stance, pairs), strict=True):
        if distance > position * leg:
            yield f"{one} and {other} are {1e3 * distance:.1f} mm from each other's mirror images"
        if abs(masses[one] - masses[other]) > mass * max(masses[one], masses[other]):
            yield f"{one} moves {masses[one]:.3f} kg, {other} {masses[other]:.3f} kg"
        for key in ("velocity", "effort", "control"):
            left, right = (getattr(table.joints[name], key) for name in (one, other))
            if left != right:
                yield f"{key} of {one} is {left}, of {other} {right}"


def _distances(stance: Stance, pairs: list[tuple[str, str]]) -> list[float]:
    """Return the largest distance of each left joint's anchor, and its subtree's CoM, from the mirror image [m]."""
    mj, data = stance.model.mj, mujoco.MjData(stance.model.mj)
    base = stance.model.body(stance.robot.tables.base)
    data.qpos[:] = mj.qpos0
    mujoco.mj_kinematics(mj, data)
    axes = [(data.joint(one).xaxis * -_MIRROR, data.joint(other).xaxis.copy()) for one, other in pairs]
    signs = np.array([1.0 if float(left @ right) > 0 else -1.0 for left, right in axes])  # of mirrored angles
    largest, rng = np.zeros(len(pairs)), np.random.default_rng(0)
    for _ in range(_POSTURES):
        angles = rng.uniform(-_ANGLE, _ANGLE, len(pairs))
        found = []
        for names, turns, flip in zip(zip(*pairs, strict=True), (angles, angles * signs), (1.0, _MIRROR), strict=True):
            data.qpos[:] = mj.qpos0
            data.qpos[3:7] = (1.0, 0.0, 0.0, 0.0)
            for name, angle in zip(names, turns, strict=True):
                data.joint(name).qpos[0] = angle
            mujoco.mj_fwdPosition(mj, data)
            points = [(data.joint(name).xanchor, data.subtree_com[mj.joint(name).bodyid[0]]) for name in names]
            found.append((np.array(points) - data.xpos[base]) * flip)
        largest = np.maximum(largest, np.linalg.norm(found[0] - found[1], axis=2).max(axis=1))
    return [float(distance) for distance in largest]
