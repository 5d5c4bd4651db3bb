"""Self-test of a robot: each acceptance test passes or states why it failed."""

from pathlib import Path

import pytest

from harness.closed_loop import load_robot
from harness.places import ROBOTS
from valor.robot.description import RobotDescription
from valor.self_test.acceptance import DIRECTIONS, SelfTest
from valor.self_test.results import PROFILES, AcceptanceResult
from valor.valorctl.robots import robot_check


def result_of(robot: RobotDescription, name: str) -> AcceptanceResult:
    return dict(SelfTest(robot, "hardware").tests())[name]()


@pytest.mark.parametrize("name", ["passive", "push left"])
def test_a_valid_robot_passes(name: str) -> None:
    result = result_of(load_robot("thor"), name)
    assert result.passed, result.reason
    assert result.numbers is not None and result.numbers.tilt < 0.1 and result.numbers.unsolved == 0


def test_the_tests_depend_on_the_limbs() -> None:
    names = [name for name, _ in SelfTest(load_robot("escher"), "ideal").tests()]
    pushes = [f"push {direction}" for direction in DIRECTIONS]
    assert names == ["passive", "stand", "arm up", *pushes, "six steps", "walk"]


def test_a_failed_test_states_why() -> None:
    robot = load_robot("escher", nominal_posture={"l_ankle_pitch": -0.3, "r_ankle_pitch": -0.3})
    result = result_of(robot, "passive")
    assert not result.passed and "expected" in result.reason


def test_a_robot_that_cannot_be_loaded_fails(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text("name: nobody\n")
    results = robot_check.run(tmp_path, lambda: None, lambda _: None)
    assert [result.profile for result in results] == list(PROFILES)
    assert not any(result.passed for result in results)
    assert all("robot.yaml" in result.reason for result in results)


def test_our_robots_have_the_profiles() -> None:
    for file in sorted(ROBOTS.glob("*/robot.yaml")):
        assert set(PROFILES) <= set(RobotDescription.load(file.parent).tables.actuators)
