"""Joints that nothing drives: they move in the plant and are coupled there; controllers take them for fixed."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from harness.generated_robot import Build, mjcf
from tests.unit.robot_setup.builds import BUILDS, made
from valor.robot.checks.folder import examine
from valor.robot.description import RobotDescription
from valor.robot.model import controller_model, full_model
from valor.robot_setup.new import new_robot
from valor.self_test.acceptance import SelfTest
from valor.simulation.plant import Plant

TOES, RODS, TIPS = ([f"{side}_{name}" for side in ("left", "right")] for name in ("toe", "rod", "finger_tip"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(BUILDS["sprung toes, rods in loops, coupled fingers"], tmp_path_factory.mktemp("sprung")).folder


@pytest.fixture(scope="module")
def robot(folder: Path) -> RobotDescription:
    return examine(folder).require_none()


def changed(folder: Path, tmp_path: Path, file: str, pattern: str, text: str) -> list[str]:
    """Faults of a copy with something else in a file."""
    for each in ("robot.yaml", "model.xml"):
        content = (folder / each).read_text()
        made, count = re.subn(pattern, text, content, count=1) if each == file else (content, 1)
        assert count == 1
        (tmp_path / each).write_text(made)
    return [str(fault) for fault in examine(tmp_path).faults]


def test_the_plant_has_them_and_controllers_have_not(robot: RobotDescription) -> None:
    plant = Plant(robot, "flat", "ideal", 0).model.mj
    assert plant.nv == 6 + len(robot.joints) + len(robot.tables.passive)
    assert plant.neq == 4  # two loops, two finger tips
    for model in (controller_model(robot), full_model(robot)):
        assert model.mj.neq == 0
        assert not {model.mj.joint(i).name for i in range(model.mj.njnt)} & set(robot.tables.passive)
    assert full_model(robot).mj.nv == 6 + len(robot.joints)


def test_both_models_are_the_same_robot_at_rest(robot: RobotDescription) -> None:
    plant, full = Plant(robot, "flat", "ideal", 0).model, full_model(robot, "collision")
    places = []
    for model in (plant, full):
        data = mujoco.MjData(model.mj)
        data.qpos[:] = model.nominal_qpos()
        mujoco.mj_forward(model.mj, data)
        places.append({name: data.body(name).xpos for name in (*TOES, *RODS, "antenna", robot.tables.head or "")})
    for name, place in places[0].items():
        assert place == pytest.approx(places[1][name], abs=1e-6), name


def test_a_body_with_toes_and_loops_steps_and_walks(robot: RobotDescription, monkeypatch: pytest.MonkeyPatch) -> None:
    """Toes bend, loops stay closed and tips follow their fingers, while all of it stands, is pushed, and walks."""
    bent, gaps = [], []
    step = Plant.step

    def watched(plant: Plant, count: int) -> None:
        step(plant, count)
        bent.append([float(plant.data.joint(name).qpos[0]) for name in TOES])
        rows = plant.data.efc_type[: plant.data.ne] == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        gaps.append(float(np.abs(plant.data.efc_pos[: plant.data.ne][rows]).max()))

    monkeypatch.setattr(Plant, "step", watched)
    played = {name: play() for name, play in SelfTest(robot, "ideal").tests() if name in {"push forward", "walk"}}
    assert {name: result.reason for name, result in played.items()} == {"push forward": "", "walk": ""}
    assert np.ptp(bent, axis=0).min() > 0.01
    assert max(gaps) < 0.02  # m, or rad between a finger and its tip


def test_a_joint_that_is_not_simulated_is_welded_and_its_loop_open(folder: Path, tmp_path: Path) -> None:
    pattern = r"(left_rod: \{ at: \S+ simulated: )true"
    assert not changed(folder, tmp_path, "robot.yaml", pattern, r"\1false")
    plant = Plant(RobotDescription.load(tmp_path), "flat", "ideal", 0).model.mj
    assert plant.neq == 3
    names = {plant.joint(i).name for i in range(plant.njnt)}
    assert "left_rod" not in names and "right_rod" in names


@pytest.mark.parametrize(
    ("file", "pattern", "text", "fault"),
    [
        ("robot.yaml", r"  left_toe: .*\n", "", "expected all hinges of model.xml, but for passive; missing: left_toe"),
        ("robot.yaml", "  left_toe: ", "  toe: ", r"passive.toe: expected a hinge of model.xml"),
        ("robot.yaml", "  left_toe: ", "  left_knee_y_4: ", "is one of joints; expected a hinge without a drive"),
        ("robot.yaml", r"left_rod: \{ at: \S+", "left_rod: { at: 0.1,", "residual of its coupling"),
        (
            "model.xml", "  <equality>", '  <equality>\n    <joint joint1="left_knee_y_4" joint2="right_knee_y_20"/>',
            "expected none without a passive joint",
        ),
    ],
)  # fmt: skip
def test_what_is_wrong_is_reported(
    folder: Path, tmp_path: Path, file: str, pattern: str, text: str, fault: str
) -> None:
    knees = re.findall(r"(?:left|right)_knee_y_\d+(?=:)", (folder / "robot.yaml").read_text())
    text = text.replace("left_knee_y_4", knees[0]).replace("right_knee_y_20", knees[1])
    found = changed(folder, tmp_path, file, pattern, text)
    assert any(fault in each for each in found), found


def test_loops_among_driven_joints_are_left_out_and_that_is_said(tmp_path: Path) -> None:
    text = mjcf(Build()).replace(
        "</mujoco>", '<equality><connect body1="left_shin" body2="chest" anchor="0 0 0"/></equality></mujoco>'
    )
    (tmp_path / "model.xml").write_text(text)
    new_robot(tmp_path / "model.xml", tmp_path / "robot", "generated")
    assert "# constraint between left_shin and chest left out" in (tmp_path / "robot" / "robot.yaml").read_text()
    examine(tmp_path / "robot").require_none()
