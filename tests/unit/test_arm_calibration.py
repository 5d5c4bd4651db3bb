"""``calibration/arms.yaml``: effects and validation."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from harness.places import ROBOTS
from harness.waiting import some
from valor.common.errors import ConfigurationError
from valor.control.motor_command import MotorCommand
from valor.motion_manager.joints.servos import ServoCompensation
from valor.robot import arm_calibration
from valor.robot.arm_calibration import ArmCalibration, JointCalibration, LinkCalibration
from valor.robot.checks.folder import examine
from valor.robot.description import RobotDescription
from valor.robot.model import controller_model, full_model


def found(robot: RobotDescription, side: str, **changed: float) -> ArmCalibration:
    values = {
        "friction": 3.0, "damping": 0.7, "offset": 0.1, "backlash": 0.05, "effort_share": 0.0, "strength": 0.9,
        "residual": 0.2,
    }  # fmt: skip
    joint = JointCalibration(**(values | changed))
    links = {f"{side[0]}_forearm": LinkCalibration(mass=1.5, com=[0.06, 0.0, 0.01])}
    return ArmCalibration(
        poses=8, samples=900, joints=dict.fromkeys(robot.tables.group(f"{side}_arm"), joint), links=links
    )


@pytest.fixture
def robot(tmp_path: Path) -> RobotDescription:
    shutil.copytree(ROBOTS / "escher", tmp_path / "escher")
    return RobotDescription.load(tmp_path / "escher")


def write(robot: RobotDescription, **arms: ArmCalibration) -> Path:
    return arm_calibration.write(robot, arm_calibration.joined(robot, arms))


def test_the_file_is_read_back_and_keeps_the_other_arm(robot: RobotDescription) -> None:
    assert arm_calibration.load(robot) is None
    write(robot, left_arm=found(robot, "left"))
    write(robot, right_arm=found(robot, "right", friction=4.0))
    table = some(arm_calibration.load(robot))
    assert table.left_arm == found(robot, "left") and table.right_arm == found(robot, "right", friction=4.0)
    assert [group for group, _ in table.present()] == ["left_arm", "right_arm"]
    assert not examine(robot.folder).faults
    assert [file.name for file in (robot.folder / "calibration").iterdir()] == ["arms.yaml"]


def test_only_controllers_use_the_identified_links(robot: RobotDescription) -> None:
    before = controller_model(robot)
    forearm = before.body("r_forearm")
    mass, inertia = float(before.mj.body_mass[forearm]), before.mj.body_inertia[forearm].copy()
    write(robot, right_arm=found(robot, "right"))
    after = controller_model(robot)
    assert after.mj.body_mass[forearm] == 1.5
    np.testing.assert_allclose(after.mj.body_ipos[forearm], (0.06, 0.0, 0.01))
    np.testing.assert_allclose(after.mj.body_inertia[forearm], inertia * 1.5 / mass, rtol=1e-6)
    assert full_model(robot).mj.body("r_forearm").mass[0] == mass


def test_servos_start_with_identified_parameters(robot: RobotDescription) -> None:
    write(robot, right_arm=found(robot, "right", backlash=0.14))
    servos = ServoCompensation(robot, MotorCommand(robot))
    right = np.isin(servos.joints, robot.group_indices("right_arm"))
    np.testing.assert_array_equal(servos.share, np.where(right, 0.0, 1.0))
    np.testing.assert_allclose(servos.play, np.where(right, 0.07, 0.0))
    np.testing.assert_allclose(servos.friction, np.where(right, 3.0, 0.0))


@pytest.mark.parametrize(
    ("old", "new", "reported"),
    [
        ("robot: escher", "robot: thor", "robot: got 'thor'; expected 'escher'"),
        ("r_wrist_yaw:", "r_wrist_jaw:", "right_arm.joints: got r_shoulder_pitch, "),
        ("friction: 3.0", "friction: 99.0", "friction: got 99 N·m; expected at most the joint's effort limit, 60 N·m"),
        ("friction: 3.0", "friction: -3.0", "friction: expected"),
        ("strength: 0.9", "strength: .nan", "strength: "),
        ("right_arm:", "right_leg:", "right_leg: unknown key; did you mean 'right_arm'?"),
        ("r_forearm:", "r_fourarm:", "right_arm.links.r_fourarm: expected a body of model.xml with an inertial"),
        ("mass: 1.5", "mass: 0", "mass: expected"),
    ],
)
def test_an_invalid_key_is_rejected_with_its_line(robot: RobotDescription, old: str, new: str, reported: str) -> None:
    file = write(robot, right_arm=found(robot, "right"))
    content = file.read_text()
    assert old in content
    file.write_text(content.replace(old, new, 1))
    with pytest.raises(ConfigurationError, match=r"arms\.yaml:\d+:\d+: ") as caught:
        controller_model(robot)
    assert reported in str(caught.value) and len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [("model.xml", "<worldbody>", "<worldbody> "), ("robot.yaml", "stiffness: 150", "stiffness: 160")],
)
def test_a_calibration_of_a_changed_robot_is_rejected(robot: RobotDescription, file: str, old: str, new: str) -> None:
    write(robot, right_arm=found(robot, "right"))
    changed = robot.folder / file
    changed.write_text(changed.read_text().replace(old, new, 1 if file == "model.xml" else -1))
    again = RobotDescription.load(robot.folder)
    with pytest.raises(ConfigurationError, match=r"fits: got \w{16}; expected \w{16}: model.xml or .* changed: "):
        arm_calibration.load(again)
    assert any("calibrate again" in str(fault) for fault in examine(robot.folder).faults)
    write(again, left_arm=found(robot, "left"))  # what does not fit any more is not kept
    table = some(arm_calibration.load(again))
    assert [group for group, _ in table.present()] == ["left_arm"]


def test_a_file_that_cannot_be_written_is_reported(robot: RobotDescription) -> None:
    (robot.folder / "calibration").write_text("in the way")
    with pytest.raises(ConfigurationError, match=r"arms\.yaml: cannot be written: "):
        write(robot, right_arm=found(robot, "right"))
