"""How the emulated robot's time passes beside the wall's: a slow computer is a slow robot."""

import time
from collections.abc import Callable

import numpy as np
import pytest

from harness.places import ROBOTS
from valor.common.instance import Settings
from valor.common.messages import JointMode
from valor.device_emulators.robot import MAX_ADVANCE, PAUSE_TIMEOUT, STALENESS, SimulatedRobot
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


@pytest.fixture
def pass_time(robot: SimulatedRobot) -> Callable[[float], None]:
    """Lets time pass on the wall, turn by turn."""
    now = time.monotonic()
    robot.pass_until(now)

    def pass_time(seconds: float) -> None:
        nonlocal now
        for _ in range(round(seconds / TURN)):
            now += TURN
            robot.pass_until(now)

    return pass_time


def command(robot: SimulatedRobot) -> None:
    zero = dict.fromkeys(("velocity", "effort", "stiffness", "damping"), 0.0)
    robot.command(LEGS, JointMode.POSITION, {"position": robot.measured.joint_position[LEGS], **zero})


def test_it_keeps_to_the_wall_while_nobody_is_there(robot: SimulatedRobot, pass_time: Callable[[float], None]) -> None:
    pass_time(0.2)
    assert robot.time == pytest.approx(0.2, abs=STEP) and robot.slip == pytest.approx(0.0, abs=STEP)


@pytest.mark.parametrize("ask", [command, SimulatedRobot.state_requested], ids=["command", "state"])
def test_it_waits_for_whoever_is_there_and_goes_on_with_the_next_command(
    robot: SimulatedRobot, pass_time: Callable[[float], None], ask: Callable[[SimulatedRobot], None]
) -> None:
    ask(robot)
    pass_time(0.1)
    assert robot.time == pytest.approx(STALE, abs=STEP), "no farther without another command"
    assert robot.slip == pytest.approx(0.1 - STALE, abs=2 * STEP)
    command(robot)
    pass_time(0.01)
    assert robot.time == pytest.approx(STALE + 0.01, abs=2 * STEP), "what was lost is not made up"


def test_whoever_is_gone_is_not_waited_for(robot: SimulatedRobot, pass_time: Callable[[float], None]) -> None:
    command(robot)
    pass_time(PAUSE_TIMEOUT)
    before = robot.time
    pass_time(0.2)
    assert robot.time - before == pytest.approx(0.2, abs=0.02), "the drives' watchdogs hold the robot"


def test_a_stall_of_the_bench_is_made_up_a_little_and_the_rest_is_slip(robot: SimulatedRobot) -> None:
    now = time.monotonic()
    robot.pass_until(now)
    robot.pass_until(now + 1.0)
    assert robot.time == pytest.approx(MAX_ADVANCE, abs=STEP)
    assert robot.time + robot.slip == pytest.approx(1.0, abs=STEP)
