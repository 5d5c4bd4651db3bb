"""A robot played rung by rung: it passes, or the rung says why not."""

from __future__ import annotations

from pathlib import Path

import pytest

from harness.closed_loop import load_robot
from harness.places import ROBOTS
from valor.rehearsal.rungs import DIRECTIONS, PROFILES, Rehearsal, Rung
from valor.robot.description import RobotDescription
from valor.valorctl import robot_play


def played(robot: RobotDescription, name: str) -> Rung:
    return dict(Rehearsal(robot, "hardware").rungs())[name]()


@pytest.mark.parametrize("name", ["passive", "push left"])
def test_a_sound_robot_passes(name: str) -> None:
    rung = played(load_robot("thor"), name)
    assert rung.passed, rung.reason
    assert rung.numbers is not None
    assert rung.numbers.tilt < 0.1
    assert rung.numbers.unsolved == 0
    assert rung.plain()["passed"]


def test_it_climbs_all_rungs_that_its_limbs_allow() -> None:
    names = [name for name, _ in Rehearsal(load_robot("escher"), "ideal").rungs()]
    pushes = [f"push {direction}" for direction in DIRECTIONS]
    assert names == ["passive", "stand", "arm up", *pushes, "six steps", "walk"]


def test_a_rung_that_fails_says_why() -> None:
    robot = load_robot("escher", nominal_posture={"l_ankle_pitch": -0.3, "r_ankle_pitch": -0.3})
    rung = played(robot, "passive")
    assert not rung.passed
    assert "expected" in rung.reason


def test_what_cannot_be_played_is_a_rung_that_failed(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text("name: nobody\n")
    rungs = robot_play.play(tmp_path, lambda: None, lambda _: None)
    assert [rung.profile for rung in rungs] == list(PROFILES) == list(robot_play.PROFILES)
    assert not any(rung.passed for rung in rungs)
    assert all("robot.yaml" in rung.reason for rung in rungs)


def test_ours_are_played_under_profiles_that_they_have() -> None:
    for file in sorted(ROBOTS.glob("*/robot.yaml")):
        assert set(PROFILES) <= set(RobotDescription.load(file.parent).tables.actuators)
