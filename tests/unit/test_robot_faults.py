"""ESCHER's folder broken in one way or several: every fault is a line with file, line and key, and nothing else is."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import NamedTuple

import pytest
from typer.testing import CliRunner

from harness.places import ROBOTS
from valor.common.errors import ConfigurationError
from valor.valorctl import instance_setup, robot_check
from valor.valorctl.app import app
from valor.valorctl.instance_setup import Request

ESCHER = ROBOTS / "escher"


class Broken(NamedTuple):
    """A change, and the key that is named."""

    old: str
    new: str
    key: str
    told: str
    file: str = "robot.yaml"


LEG = "r_knee_pitch, r_ankle_pitch, r_ankle_roll]"
BROKEN = {
    "five joints a leg": Broken(LEG, "r_knee_pitch, r_ankle_pitch]", "groups.right_leg", "5 joints; expected 6"),
    "zero ankle stiffness": Broken(
        "control: force, servo: { stiffness: 1000, damping: 50 }",
        "control: force, servo: { stiffness: 0, damping: 50 }",
        "joints.l_ankle_roll.servo.stiffness",
        "gives way",
    ),
    "a servo too strong for its finger": Broken(
        "l_thumb_pitch:    { lower: -0.785, upper: 1.571, velocity: 4.189, effort: 4, control: position, "
        "servo: { stiffness: 10, damping: 0.2 }",
        "l_thumb_pitch:    { lower: -0.785, upper: 1.571, velocity: 4.189, effort: 4, control: position, "
        "servo: { stiffness: 10, damping: 20 }",
        "joints.l_thumb_pitch.servo.damping",
        "at most",
    ),
    "a hip too weak for one leg": Broken(
        "l_hip_roll:       { lower: -0.524, upper: 0.785, velocity: 12, effort: 150",
        "l_hip_roll:       { lower: -0.524, upper: 0.785, velocity: 12, effort: 30",
        "joints.l_hip_roll.effort",
        "standing on the left foot",
    ),
    "an arm preset in the chest": Broken(
        "left: { l_shoulder_pitch: -0.2, l_shoulder_roll: 0.15, l_shoulder_yaw: -0.5, l_elbow_pitch: 0,",
        "left: { l_shoulder_pitch: -0.2, l_shoulder_roll: -0.5, l_shoulder_yaw: -1.5, l_elbow_pitch: 0.3,",
        "arm_presets.fold.left",
        "touches",
    ),
    "a lidar in degrees": Broken(
        "nominal_posture:\n", "nominal_posture:\n  lidar_roll: 90\n", "nominal_posture.lidar_roll", "radians"
    ),
    "an edge margin wider than the sole": Broken(
        "self_collision:", "disturbance: { edge_margin: 0.08 }\nself_collision:", "disturbance.edge_margin", "half",
    ),
    "a CoM margin wider than the sole": Broken(
        "self_collision:", "pelvis: { com_margin: 0.08 }\nself_collision:", "pelvis.com_margin", "half width"
    ),
    "a sole above the foot's underside": Broken(
        '<site name="l_sole" pos="0 0 -0.08"/>', '<site name="l_sole" pos="0 0 -0.073"/>', "feet.left.sole",
        "above the lowest", "model.xml",
    ),
    "a body without mass": Broken(
        '<inertial mass="7.1" pos="0.005 0.005 -0.175" diaginertia="0.086679 0.086679 0.019998"/>', "",
        "body.l_thigh", "no mass", "model.xml",
    ),
    "no XML": Broken("</worldbody>", "</world>", "(whole", "MISMATCHED", "model.xml"),
    "degrees": Broken('angle="radian"', 'angle="degree"', "compiler", "expected radian", "model.xml"),
    "a missing mesh": Broken(
        "<worldbody>", '<asset><mesh name="head" file="head.stl"/></asset><worldbody>', "mesh.head.stl", "no file",
        "model.xml",
    ),
    "coupled joints": Broken(
        "</worldbody>",
        '</worldbody><equality><joint joint1="l_hip_roll" joint2="r_hip_roll"/></equality>',
        "joint.l_hip_roll",
        "independent",
        "model.xml",
    ),
}  # fmt: skip


def folder_of(tmp_path: Path, *broken: Broken) -> Path:
    """ESCHER's folder, changed."""
    folder = tmp_path / "robot"
    shutil.copytree(ESCHER, folder)
    for each in broken:
        file = folder / each.file
        text = file.read_text()
        assert each.old in text
        file.write_text(text.replace(each.old, each.new, 1))
    return folder


def told(error: ConfigurationError) -> tuple[str, int, str, str]:
    """File, line, key, what."""
    match = re.fullmatch(r".*/([^/:]+):(\d+):\d+: (\S+|\(whole file\)): (.+)", str(error))
    assert match is not None, error
    return match[1], int(match[2]), match[3], match[4]


@pytest.mark.parametrize("broken", BROKEN.values(), ids=BROKEN.keys())
def test_a_fault_is_found_where_it_is(broken: Broken, tmp_path: Path) -> None:
    folder = folder_of(tmp_path, broken)
    faults = [told(fault) for fault in robot_check.examine(folder).faults]
    named = [each for each in faults if each[2].startswith(broken.key)]
    assert named, faults
    file, line, key, what = named[0]
    assert file == ("robot.yaml" if "feet" in key else broken.file)
    assert broken.told in what
    last = key.rpartition(".")[2]
    if "." in key and not last.isdecimal():
        assert last in (folder / file).read_text().splitlines()[line - 1]


def test_independent_faults_are_told_together(tmp_path: Path) -> None:
    names = ("zero ankle stiffness", "a hip too weak for one leg", "an arm preset in the chest",
             "an edge margin wider than the sole")  # fmt: skip
    chosen = [BROKEN[name] for name in names]
    findings = robot_check.examine(folder_of(tmp_path, *chosen))
    assert {told(fault)[2] for fault in findings.faults} == {each.key for each in chosen}
    with pytest.raises(ConfigurationError) as refused:
        instance_setup.plan(Request(robot=str(tmp_path / "robot")))
    assert len(str(refused.value).splitlines()) == len(findings.faults) + len(findings.unchecked)


def test_wrong_keys_are_told_together(tmp_path: Path) -> None:
    findings = robot_check.examine(
        folder_of(
            tmp_path,
            Broken("control_rate: 500", "control_rate: 7", "", ""),
            Broken("base: pelvis", "bass: pelvis", "", ""),
            Broken("half_width: 0.07425 }", "half_width: wide }", "", ""),
        )
    )
    assert {told(fault)[2] for fault in findings.faults} == {"control_rate", "bass", "base", "feet.left.half_width"}
    assert findings.unchecked


def test_what_counts_on_something_broken_is_left_out_and_said(tmp_path: Path) -> None:
    findings = robot_check.examine(folder_of(tmp_path, BROKEN["five joints a leg"]))
    assert all("groups" in line for line in findings.unchecked)
    assert findings.unchecked


def test_check_ends_with_1_and_a_line_each(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, BROKEN["zero ankle stiffness"], BROKEN["coupled joints"])
    result = CliRunner().invoke(app, ["robot", "check", str(folder), "--no-play", "--json"])
    assert isinstance(result.exception, ConfigurationError)
    assert '"faults"' in result.output


def test_ours_have_no_fault() -> None:
    for name in ("escher", "thor"):
        assert CliRunner().invoke(app, ["robot", "check", name, "--no-play"]).exit_code == 0
