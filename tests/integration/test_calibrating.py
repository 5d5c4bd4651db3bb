"""``valorctl calibrate arm`` on a robot with worn arms: what it finds, refuses, and leaves when interrupted."""

import json
import shutil
import signal
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from harness.places import ROBOTS
from harness.system import RosClient, System, running
from harness.waiting import some, wait_until
from valor.robot import arm_calibration
from valor.robot.arm_calibration import FILE
from valor.robot.description import RobotDescription
from valor.simulation.actuators import Gears

ARM = "right_arm"
PATIENCE = 240.0  # [s]
MOVED, BACK, LED = 0.3, 0.06, 0.05  # [rad]
pytestmark = pytest.mark.timeout(900)


@pytest.fixture(scope="module")
def robot() -> Iterator[RobotDescription]:
    with tempfile.TemporaryDirectory(prefix="valor-", ignore_cleanup_errors=True) as home:
        shutil.copytree(ROBOTS / "escher", Path(home) / "escher")
        yield RobotDescription.load(Path(home) / "escher")


@pytest.fixture(scope="module")
def system(robot: RobotDescription) -> Iterator[System]:
    options = ("--robot", str(robot.folder), "--actuators", "hdt_arms", "--no-bag")
    with running("calibrating", robot.folder.parent / "home", *options) as made:
        yield made


@pytest.fixture(scope="module")
def client(system: System) -> Iterator[RosClient]:
    made = RosClient(system.join())
    yield made
    made.close()


def off(client: RosClient, robot: RobotDescription, home: dict[str, float]) -> float:
    """How far the arm is from where it was [rad]."""
    now = client.joint_positions()
    return max(abs(now[name] - home[name]) for name in robot.tables.group(ARM))


def test_interrupted_the_arm_is_back_without_a_file(system: System, client: RosClient, robot: RobotDescription) -> None:
    home = client.joint_positions()
    process = system.start("calibrate", "arm", "right")
    try:
        wait_until(lambda: process.poll() is not None or off(client, robot, home) > MOVED, PATIENCE, "the arm moves")
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
    assert process.returncode == 128 + signal.SIGINT, out + err
    assert err == "valorctl: interrupted by SIGINT\n"
    assert not (robot.folder / "calibration").exists()
    wait_until(lambda: off(client, robot, home) < BACK, PATIENCE, "the arm is back")
    assert system.status()["control_mode"] == "stand"


def test_it_finds_what_the_arm_is_and_the_robot_keeps_it(system: System, robot: RobotDescription) -> None:
    output = system.valorctl("calibrate", "arm", "right", "--poses", "3", "--json", timeout=PATIENCE)
    found = json.loads(output.stdout)
    assert found["file"] == str(robot.folder / FILE)
    table = some(arm_calibration.load(robot))
    assert table.right_arm is not None and table.right_arm.poses == 3
    gears = Gears.of(robot, robot.tables.actuators["hdt_arms"])
    places = robot.group_indices(ARM)
    joints = table.right_arm.joints.values()
    np.testing.assert_allclose([each.friction for each in joints], gears.friction[places], atol=0.8)
    np.testing.assert_allclose([each.effort_share for each in joints], 0.0, atol=0.2)
    wide = [(each.backlash, 2.0 * gears.half_backlash[i]) for each, i in zip(joints, places, strict=True)]
    shown = [(width, truth) for width, truth in wide if width is not None]
    assert len(shown) >= 4
    assert all(width == pytest.approx(truth, abs=0.012) for width, truth in shown)
    for name, joint in table.right_arm.joints.items():
        assert joint.residual < found[ARM]["nominal_residual"][name]
    assert system.status()["control_mode"] == "stand"
    system.valorctl("robot", "check", str(robot.folder), "--no-play")


def test_what_cannot_be_calibrated_is_refused(system: System, client: RosClient, robot: RobotDescription) -> None:
    file = robot.folder / FILE
    shutil.rmtree(file.parent, ignore_errors=True)
    file.parent.write_text("in the way")
    output = system.valorctl("calibrate", "arm", expect=1).stderr
    assert output == f"valorctl: {file}: cannot be written: Not a directory\n"
    file.parent.unlink()
    system.valorctl("mode", "stand_manipulate")
    home = client.joint_positions()
    mover = system.start("arm", "right", "forward", "--speed", "0.05")
    try:
        wait_until(lambda: off(client, robot, home) > LED, PATIENCE, "the arm is led")
        output = system.valorctl("calibrate", "arm", "right", "--dry-run", expect=1, timeout=PATIENCE).stderr
        assert "another client moves it" in output
    finally:
        mover.send_signal(signal.SIGINT)
        mover.communicate(timeout=PATIENCE)
    system.valorctl("stop", "--freeze")
    output = system.valorctl("calibrate", "arm", expect=1).stderr
    assert output.startswith("valorctl: calibrate left arm: the robot is in freeze: ")
    assert output.endswith("; expected stand or stand_manipulate\n")
    assert not file.exists()
