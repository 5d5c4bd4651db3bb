"""What the Comms Manager remembers of the last Motor, and when a silent robot is left limp."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from valor.common.messages import JointMode, Motor
from valor.comms_manager.latch import BehaviorLatch
from valor.comms_manager.leader import drives

EPOCH = 123
N = 4


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "behavior.json"


def test_the_behavior_outlives_the_process(file: Path) -> None:
    latch = BehaviorLatch(file, EPOCH)
    assert latch.behavior == ""
    for behavior in ("stand_prep", "stand", "stand", "freeze"):
        latch.update(behavior)
    assert latch.behavior == "freeze"
    latch.close()
    assert BehaviorLatch(file, EPOCH).behavior == "freeze"


def test_another_life_of_the_instance_begins_without_it(file: Path) -> None:
    latch = BehaviorLatch(file, EPOCH)
    latch.update("fall")
    latch.close()
    assert BehaviorLatch(file, EPOCH + 1).behavior == ""


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"epoch": 123}', "null", "\x00\xff"])
def test_a_file_that_says_nothing_is_none(file: Path, text: str) -> None:
    file.write_bytes(text.encode("latin-1"))
    assert BehaviorLatch(file, EPOCH).behavior == ""


def test_a_disk_that_takes_nothing_is_logged_and_the_robot_goes_on(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    latch = BehaviorLatch(tmp_path / "nowhere" / "behavior.json", EPOCH)
    latch.update("stand")
    latch.close()
    assert latch.behavior == "stand"
    assert "after a restart the behavior stand is not known" in caplog.text


def motor(mode: JointMode, effort: float = 0.0, stiffness: float = 0.0) -> Motor:
    """One joint in a mode, the others off."""
    modes = np.full(N, JointMode.OFF, dtype=np.uint8)
    modes[1] = mode
    efforts, stiffnesses = np.full(N, 0.0), np.full(N, 0.0)
    efforts[1], stiffnesses[1] = effort, stiffness
    return Motor(0, 1, 1, modes, np.ones(N), np.zeros(N), efforts, stiffnesses, np.ones(N), "fall", 1)


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        (motor(JointMode.OFF, effort=5.0, stiffness=5.0), False),
        (motor(JointMode.FORCE), False),
        (motor(JointMode.FORCE, stiffness=5.0), False),
        (motor(JointMode.FORCE, effort=-0.1), True),
        (motor(JointMode.IMPEDANCE), False),
        (motor(JointMode.IMPEDANCE, stiffness=0.1), True),
        (motor(JointMode.IMPEDANCE, effort=0.1), True),
        (motor(JointMode.POSITION), True),
    ],
)
def test_a_motor_is_limp_when_nothing_in_it_can_move_a_joint_at_rest(said: Motor, expected: bool) -> None:
    assert drives(said) is expected
