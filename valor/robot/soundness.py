"""All that is wrong with a robot's folder, a line each, before anything starts.

``valorctl up`` asks, and ``valorctl robot check``. A check that counts on what is broken is left out, and that is said.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from msgspec import structs

from valor.common.errors import ConfigurationError, SeveralFaultsError
from valor.common.table import TableError
from valor.robot import checks, drive_checks, get_up_table
from valor.robot.checks import Stance
from valor.robot.description import RobotDescription, read_tables
from valor.robot.model import controller_model
from valor.robot.rules import broken_rules
from valor.robot.tables import RobotTables


class Check(NamedTuple):
    """A check of the robot in its nominal posture, and the keys of robot.yaml that it counts on."""

    find: Callable[[Stance], Iterator[TableError]]
    counts_on: tuple[str, ...] = ()


CHECKS: tuple[Check, ...] = (
    Check(checks.sites_are_on_their_bodies),
    Check(checks.torso_is_below_the_chest, ("groups", "chest")),
    Check(checks.sides_are_where_they_are_said_to_be, ("feet", "hands", "chest")),
    Check(checks.groups_are_what_they_are_called, ("groups", "feet", "hands", "chest")),
    Check(checks.soles_stand_on_the_ground, ("feet", "nominal_posture")),
    Check(checks.soles_lie_on_their_geoms, ("feet",)),
    Check(checks.soles_are_as_large_as_the_feet, ("feet",)),
    Check(checks.feet_stand_apart, ("feet", "nominal_posture", "footsteps")),
    Check(checks.the_com_is_over_the_soles, ("feet", "nominal_posture")),
    Check(checks.couplings_hold, ("passive", "nominal_posture")),
    Check(checks.nothing_touches, ("nominal_posture",)),
    Check(checks.arm_presets_touch_nothing, ("nominal_posture", "arm_presets")),
    Check(checks.pairs_are_kept_apart, ("nominal_posture",)),
    Check(checks.the_size_is_the_models, ("size", "groups")),
    Check(checks.legs_are_as_long_as_walking_says, ("groups", "nominal_posture", "walking")),
    Check(drive_checks.joints_can_carry_the_robot, ("groups", "feet", "nominal_posture", "nominal_base_height")),
    Check(drive_checks.servos_hold_the_robot_up, ("groups", "nominal_posture")),
    Check(drive_checks.servos_are_damped),
    Check(drive_checks.servos_suit_the_physics_step, ("nominal_posture",)),
)


@dataclass
class Findings:
    """What was found.

    Attributes:
        robot: its description; None: robot.yaml cannot be read.
        faults: one error each, with file, line and key.
        unchecked: lines that say what could not be looked at, and why.
    """

    robot: RobotDescription | None = None
    faults: list[ConfigurationError] = field(default_factory=list)
    unchecked: list[str] = field(default_factory=list)
    broken: set[str] = field(default_factory=set)  # first keys of what is wrong in robot.yaml

    def require_none(self) -> RobotDescription:
        """The robot.

        Raises:
            ConfigurationError: there are faults; a line for each.
        """
        if self.unchecked:
            raise SeveralFaultsError(self.faults, self.unchecked)
        SeveralFaultsError.require_none(self.faults)
        assert self.robot is not None
        return self.robot

    def tried(self, step: Callable[[], object]) -> bool:
        """Do something; whether it raised no ``ConfigurationError``. Its faults are kept."""
        try:
            step()
        except ConfigurationError as error:
            self.faults += SeveralFaultsError.each(error)
            return False
        return True

    def add(self, robot: RobotDescription, found: Iterable[TableError]) -> None:
        """Faults of robot.yaml."""
        for each in found:
            self.faults.append(robot.error(each.path, each.what))
            self.broken.update(each.path[:1])


def examine(
    folder: Path,
    control_rate: float | None = None,
    beyond: Iterable[Callable[[RobotDescription], Iterator[TableError]]] = (),
) -> Findings:
    """Look at all of a folder.

    Args:
        folder: of the robot.
        control_rate: instead of robot.yaml's [Hz].
        beyond: checks that need neither model nor posture, of what others read in robot.yaml; they may raise
            ``ConfigurationError``.
    """
    findings, file = Findings(), folder / "robot.yaml"
    if not file.is_file():
        findings.faults.append(ConfigurationError(f"{file}: no such file; expected a robot's folder with robot.yaml"))
        return findings
    tables: list[RobotTables] = []
    if not findings.tried(lambda: tables.append(read_tables(file))):
        findings.unchecked.append(f"{file}: not checked until it can be read: all that its keys must keep together")
        return findings
    rate = tables[0].control_rate if control_rate is None else control_rate
    robot = findings.robot = RobotDescription(folder, structs.replace(tables[0], control_rate=rate), ruled=False)
    findings.add(robot, broken_rules(robot.tables))
    for check in beyond:
        findings.tried(lambda check=check: findings.add(robot, check(robot)))  # type: ignore[misc]
    findings.tried(lambda: get_up_table.load(robot))
    if control_rate is None:  # whoever gives another answers for it
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
    left_out: dict[str, list[str]] = {}
    for check in CHECKS:
        if doubtful := findings.broken.intersection(check.counts_on):
            left_out.setdefault(", ".join(sorted(doubtful)), []).append(check.find.__name__.replace("_", " "))
        else:
            findings.add(robot, list(check.find(stances[0])))
    for keys, names in left_out.items():
        findings.unchecked.append(f"{robot.file}: not checked until {keys} is right: {'; '.join(names)}")
