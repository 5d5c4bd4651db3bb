"""How the emulated robot's time passes beside the wall's: a slow computer is a slow robot."""

from __future__ import annotations

import time

import numpy as np
import pytest

from harness.places import ROBOTS
from valor.common.instance import Settings
from valor.common.messages import JointMode
from valor.device_emulators.robot import LONGEST, PATIENCE, STALENESS, SimulatedRobot
from valor.devices.table import SeaCanFd
from valor.robot.description import RobotDescription

DESCRIPTION = RobotDescription.load(ROBOTS / "escher", 250.0)
STALE = STALENESS * DESCRIPTION.control_period  # [s]
STEP = 0.001  # of the physics [s]
TURN = 0.002  # between looks [s]


@pytest.fixture
def robot() -> SimulatedRobot:
    robot = SimulatedRobot(DESCRIPTION, Settings(robot=DESCRIPTION.folder, ros_domain_id=1, actuators="ideal"))
    robot.power(LEGS, True)
    robot.hold(LEGS)
    assert robot.released
    return robot


LEGS = np.array(
    [
        DESCRIPTION.index[joint]
        for device in DESCRIPTION.tables.devices.values()
        if isinstance(device, SeaCanFd)
        for joint in device.joints
    ],
    dtype=np.intp,
)


def command(robot: SimulatedRobot) -> None:
    """Have the legs stay."""
    position = robot.measured.joint_position[LEGS]
    robot.command(
        LEGS, mode=JointMode.POSITION, position=position, velocity=0.0, effort=0.0, stiffness=0.0, damping=0.0
    )


def pass_time(robot: SimulatedRobot, start: float, seconds: float) -> float:
    """Let time pass on the wall, turn by turn; returns its end."""
    for k in range(1, round(seconds / TURN) + 1):
        robot.pass_until(start + k * TURN)
    return start + seconds


def test_it_keeps_to_the_wall_when_nobody_is_there_yet(robot: SimulatedRobot) -> None:
    now = time.monotonic()
    robot.pass_until(now)
    pass_time(robot, now, 0.2)
    assert robot.time == pytest.approx(0.2, abs=STEP)
    assert robot.slip == pytest.approx(0.0, abs=STEP)


def test_it_waits_for_commands_and_goes_on_with_the_next(robot: SimulatedRobot) -> None:
    now = time.monotonic()
    robot.pass_until(now)
    command(robot)
    now = pass_time(robot, now, 0.1)
    assert robot.time == pytest.approx(STALE, abs=STEP), "no farther without another command"
    assert robot.slip == pytest.approx(0.1 - STALE, abs=2 * STEP)
    command(robot)
    now = pass_time(robot, now, 0.01)
    assert robot.time == pytest.approx(STALE + 0.01, abs=2 * STEP), "what was lost is not made up"
    assert "99 %: 12 ms" in robot.commands.describe()


def test_it_waits_for_whoever_asks_before_the_first_command(robot: SimulatedRobot) -> None:
    now = time.monotonic()
    robot.pass_until(now)
    robot.asked()
    pass_time(robot, now, 0.1)
    assert robot.time == pytest.approx(STALE, abs=STEP)


def test_whoever_is_gone_is_not_waited_for(robot: SimulatedRobot) -> None:
    now = time.monotonic()
    robot.pass_until(now)
    command(robot)
    now = pass_time(robot, now, PATIENCE)
    before = robot.time
    now = pass_time(robot, now + TURN, 0.2)
    assert robot.time - before == pytest.approx(0.2, abs=0.02), "the drives' watchdogs hold the robot"


def test_a_stall_of_the_bench_is_made_up_a_little_and_the_rest_is_slip(robot: SimulatedRobot) -> None:
    now = time.monotonic()
    robot.pass_until(now)
    robot.pass_until(now + 1.0)
    assert robot.time == pytest.approx(LONGEST, abs=STEP)
    assert robot.time + robot.slip == pytest.approx(1.0, abs=STEP)
