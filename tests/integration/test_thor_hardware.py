"""THOR on its devices: emulated motor controllers, sensors, Dynamixel arms on real ports; and two IMUs, not one."""

import math
from collections.abc import Iterator

import pytest

from harness.places import ROBOTS
from harness.waiting import PATIENCE, wait_until
from tests.integration.device_system import RobotOnDevices, on_devices
from valor.devices.dynamixel import Dynamixel
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(ROBOTS / "thor")
SPEED = 1.0  # of what is commanded [rad/s]
NEAR = 0.05  # what trajectory controllers allow a goal [rad]


@pytest.fixture(scope="module")
def thor() -> Iterator[RobotOnDevices]:
    with on_devices(robot=ROBOT.folder, actuators="series_elastic") as running:
        yield RobotOnDevices(running)


def test_every_device_is_found_and_the_robot_stands_reaches_and_grasps(thor: RobotOnDevices) -> None:
    thor.go("stand")
    units = thor.status.units
    for name, device in ROBOT.tables.devices.items():
        if isinstance(device, Dynamixel):
            assert [unit for unit in units if unit.startswith(name)] == [f"{name}/{s.joint}" for s in device.servos]
    assert {unit.split("/")[0] for unit in units} == {*ROBOT.tables.devices, "batteries"}
    thor.go("stand_manipulate")
    tables = ROBOT.tables
    thor.lead({**tables.arm_presets["forward"]["right"], **tables.hand_presets["close"]["left"]})
    wrenches = thor.measured()
    weight = wrenches.left_foot_wrench[2] + wrenches.right_foot_wrench[2]
    assert weight == pytest.approx(65.0 * 9.81, rel=0.15), "it stands on its feet"  # masses are 5 % off at most
    assert thor.behavior == "stand_manipulate"


def test_a_robot_whose_imu_is_unplugged_stands_by_the_other_one(thor: RobotOnDevices) -> None:
    """And by the first again when the other one is gone, too; without any it is held."""

    def unit(name: str) -> tuple[str, str]:
        return thor.unit(name)[:2]

    def heading() -> float:
        w, x, y, z = thor.measured().imu_orientation
        return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))

    wait_until(lambda: (unit("imu"), unit("kvh")) == (("ok", "primary"), ("ok", "stand-by")), PATIENCE, "both are well")
    thor.go("stand")
    before = heading()
    thor.fail("imu", "unplugged")
    wait_until(lambda: unit("kvh") == ("ok", "primary"), PATIENCE, "the other one leads")
    assert unit("imu")[0] == "unplugged" and unit("imu")[1].endswith("(kvh is primary)")
    assert thor.status.reaction == "keep_balance"
    assert heading() == pytest.approx(before, abs=0.02)
    standing = thor.state.time
    wait_until(lambda: thor.state.time > standing + 2_000_000_000, PATIENCE, "two seconds of the robot")
    assert thor.behavior == "stand", thor.state.reason
    thor.fail("imu", "")
    wait_until(lambda: unit("imu") == ("ok", "stand-by"), PATIENCE, "it is found again")
    thor.fail("kvh", "silent")
    wait_until(lambda: unit("imu") == ("ok", "primary"), PATIENCE, "the first leads again")
    assert thor.behavior == "stand", thor.state.reason
    thor.fail("imu", "silent")
    wait_until(lambda: thor.behavior == "freeze", PATIENCE, "without any the joints are held")
    assert thor.state.reason.startswith(("imu: no valid state", "kvh: no valid state"))
    for device in ("imu", "kvh"):
        thor.fail(device, "")
    wait_until(lambda: thor.status.reaction == "keep_balance", PATIENCE, "both are well")


def test_legs_that_lost_their_power_for_a_moment_have_the_robot_go_limp(thor: RobotOnDevices) -> None:
    """The last one: it lies afterwards. Nobody was silent; the first that is off has it held, the second lets it go."""
    thor.go("stand")
    legs = [unit for unit in thor.status.units if unit.startswith("legs/")]
    for unit in legs[:4]:
        thor.fail(unit, "unplugged", 0.05)
    wait_until(lambda: thor.behavior == "fall", PATIENCE, "it falls")
    assert "its motors are off: it had lost its power" in thor.state.reason
    assert "without motors: the robot goes limp" in thor.running.log("comms_manager")

    def on_again() -> bool:
        status = thor.status
        return all(status.states[status.units.index(unit)] == "ok" for unit in legs)

    wait_until(on_again, PATIENCE, "its motors are on again, as limp moves nothing")
    wait_until(lambda: thor.status.reaction == "keep_balance", PATIENCE, "nothing more is demanded")
    assert thor.behavior == "fall"
