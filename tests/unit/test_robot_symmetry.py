"""How far the sides of a robot are from mirror images: measured, told, and no fault."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from harness.generated_robot import Build
from harness.places import ROBOTS
from tests.unit.robot_setup.builds import made
from valor.robot.checks import Stance
from valor.robot.description import RobotDescription
from valor.robot.symmetry import asymmetries
from valor.valorctl import robot_check


@pytest.mark.parametrize("name", ["escher", "thor"])
def test_ours_are_mirror_images_to_the_last_digit(name: str) -> None:
    assert list(asymmetries(Stance(RobotDescription.load(ROBOTS / name)), 1e-9, 1e-9)) == []


def test_axes_that_are_mirrored_too_make_no_difference(tmp_path: Path) -> None:
    robot = made(Build(mirrored=True, knee=-1), tmp_path)
    assert list(asymmetries(Stance(robot), 1e-5, 1e-6)) == []


def test_what_differs_is_told_by_name(tmp_path: Path) -> None:
    robot = made(Build(), tmp_path)
    model, table = robot.model_file.read_text(), robot.file.read_text()
    thigh = re.search(r'<body name="left_thigh".*?<inertial mass="([0-9.]+)"', model, re.DOTALL)
    assert thigh is not None
    heavier = model[: thigh.start(1)] + str(float(thigh[1]) * 1.2) + model[thigh.end(1) :]
    robot.model_file.write_text(heavier)
    robot.file.write_text(re.sub(r"(  right_knee_\S+ .*?effort: )[0-9.]+", r"\g<1>150", table))
    findings = robot_check.examine(robot.folder)
    notes, told = robot_check.notes(findings), list(asymmetries(Stance(findings.require_none())))
    assert set(notes) <= {*told, notes[-1]}
    assert any("left_hip_z" in line and "kg" in line for line in told)
    assert any(line.startswith("effort of left_knee") and "150" in line for line in told)
    assert not any("right_ankle" in line for line in told)
