"""Each check of the soak sees the fault that it is for, and nothing in what is well."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from harness.motion_states import motor
from harness.places import ROBOTS
from tests.soak import checks
from valor.common.messages import Motor
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(ROBOTS / "escher")


@dataclass
class Writer:
    writer: int = 1
    sequence: int = 0

    def motor(self, behavior: str = "stand", **changes: Any) -> Motor:
        self.sequence += 1
        given: dict[str, Any] = {"time": self.sequence, "sequence": self.sequence, "writer": self.writer}
        return motor(ROBOT, **(given | {"behavior": behavior} | changes))


def at(value: float, others: Any = 0.0) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Of one joint a value."""
    made = np.full(len(ROBOT.joints), others)
    made[3] = value
    return made


def test_sound_motors_are_well() -> None:
    tried, writer = checks.MotorChecks(ROBOT), Writer()
    assert [tried.find(writer.motor(each)) for each in ("stand", "stand", "walk", "stand", "freeze")] == [[]] * 5
    tried = checks.MotorChecks(ROBOT)
    assert [tried.find(writer.motor(each)) for each in ("step", "stand_manipulate")] == [[]] * 2, (
        "two requests in a period"
    )


def test_one_that_stands_aside_begins_at_rest() -> None:
    tried, writer = checks.MotorChecks(ROBOT), Writer()
    assert [tried.find(writer.motor(each)) for each in ("walk", "reflex", "reflex", "freeze")] == [[]] * 4
    assert [tried.find(writer.motor(each)) for each in ("stand_prep", "stand", "walk", "reflex")] == [[]] * 4
    assert "walk after walk" in tried.find(writer.motor("walk"))[0]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"effort": at(np.nan)}, "effort not finite"),
        ({"stiffness": at(np.inf)}, "stiffness not finite"),
        ({"position": at(ROBOT.upper[3] + 0.001, ROBOT.nominal_posture)}, f"position of {ROBOT.joints[3]} beyond"),
        ({"position": at(ROBOT.lower[3] - 0.001, ROBOT.nominal_posture)}, f"position of {ROBOT.joints[3]} beyond"),
        ({"effort": at(-1.001 * ROBOT.effort_limit[3])}, f"effort of {ROBOT.joints[3]} beyond"),
        ({"sequence": 1}, "sequence goes back"),
        ({"behavior": "get_up"}, "no edge"),
        ({"behavior": "dance"}, "unknown behavior"),
        ({"writer": 2, "behavior": "stand"}, "after a restart"),
        ({"writer": 0, "behavior": "freeze"}, "another one has followed"),
    ],
)
def test_a_motor_that_is_not_is_named(changes: dict[str, Any], words: str) -> None:
    tried, writer = checks.MotorChecks(ROBOT), Writer()
    assert not tried.find(writer.motor())
    found = tried.find(writer.motor(**changes))
    assert len(found) == 1 and words in found[0]


def test_memory_that_grows_after_the_start_is_found() -> None:
    times = [10.0 * each for each in range(40)]
    assert checks.growth([(t, 100.0 + min(t, 50.0)) for t in times]) == pytest.approx(0.0)
    assert checks.growth([(t, 100.0 + 0.1 * t) for t in times]) > checks.GROWTH
    assert checks.growth([(t, 100.0 + t) for t in times[:8]]) == 0.0  # of too short a time


def test_processes_that_end_more_often_than_they_are_killed_are_found() -> None:
    assert checks.unexpected_ends({"a": 2}, {"a": 2}) == []
    assert checks.unexpected_ends({"a": 3}, {"a": 2}) == ["a ended 1 times by itself"]


@pytest.mark.parametrize("word", ["Traceback (most recent call last):", "Assertion failed: !_io_error", "SIGSEGV"])
def test_a_crash_is_found_in_logs(tmp_path: Path, word: str) -> None:
    (tmp_path / "a.log").write_text("all is well\n")
    assert checks.in_logs(tmp_path) == []
    (tmp_path / "b.log.1").write_text(f"x {word} y\n")
    assert len(checks.in_logs(tmp_path)) == 1
