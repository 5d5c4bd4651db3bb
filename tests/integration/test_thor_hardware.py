"""THOR on its devices: emulated motor controllers, sensors, Dynamixel arms on real ports; and two IMUs, not one."""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterator, Mapping

import numpy as np
import pytest

from harness.device_system import RobotOnDevices, on_devices
from harness.instance import RunningInstance
from harness.places import ROBOTS
from harness.waiting import PATIENCE, wait_until
from valor.common.messages import FaultRequest, JointSetpoints, Proprioceptor
from valor.common.topics import FAULT, JOINT_SETPOINTS, PROPRIOCEPTOR
from valor.devices.dynamixel import Dynamixel
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(ROBOTS / "thor")
SPEED = 1.0  # of what is commanded [rad/s]
KVH = '  kvh: { kind: kvh_1750, serial: "1750-0042", rate: 250 }\n'
NEAR = 0.05  # what trajectory controllers allow a goal [rad]


class Thor(RobotOnDevices):
    """Who commands it in the VRC's stead."""

    def __init__(self, running: RunningInstance) -> None:
        super().__init__(running)
        self._measured = PROPRIOCEPTOR.subscriber(self.node)
        self._setpoints = JOINT_SETPOINTS.publisher(self.node)

    def measured(self) -> Proprioceptor:
        """What the devices say next."""
        received = self._measured.receive(PATIENCE)
        assert received is not None
        return received.message

    def move(self, goal: Mapping[str, float]) -> None:
        """Lead joints to a goal, a set-point after the other, and wait until they are there."""
        places = [ROBOT.index[name] for name in goal]
        end = np.array(list(goal.values()))
        begin = self.measured().joint_position[places]
        began, duration = self.state.time, float(np.abs(end - begin).max()) / SPEED

        def there() -> bool:
            now = self.state.time
            share = min(1.0, 1e-9 * (now - began) / duration)
            still = np.zeros(end.size)
            self._setpoints.publish(JointSetpoints(now, list(goal), begin + share * (end - begin), still, still))
            return share == 1.0 and bool(np.abs(self.measured().joint_position[places] - end).max() < NEAR)

        wait_until(there, PATIENCE, f"{', '.join(goal)} at the goal", period=0.01)


@pytest.fixture(scope="module")
def thor(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Thor]:
    """With the thesis' second IMU beside its first."""
    folder = tmp_path_factory.mktemp("robots") / "thor"
    shutil.copytree(ROBOT.folder, folder)
    file = folder / "robot.yaml"
    file.write_text(file.read_text().replace("  neck:\n    kind:", f"{KVH}  neck:\n    kind:"))
    with on_devices(robot=folder, actuators="hardware") as running:
        yield Thor(running)


def test_every_device_is_found_and_the_robot_stands_reaches_and_grasps(thor: Thor) -> None:
    thor.go("stand")
    units = thor.status.units
    for name, device in ROBOT.tables.devices.items():
        if isinstance(device, Dynamixel):
            assert [unit for unit in units if unit.startswith(name)] == [f"{name}/{s.joint}" for s in device.servos]
    assert {unit.split("/")[0] for unit in units} == {*ROBOT.tables.devices, "kvh"}
    thor.go("stand_manipulate")
    tables = ROBOT.tables
    thor.move({**tables.arm_presets["forward"]["right"], **tables.hand_presets["close"]["left"]})
    wrenches = thor.measured()
    weight = wrenches.left_foot_wrench[2] + wrenches.right_foot_wrench[2]
    assert weight == pytest.approx(65.0 * 9.81, rel=0.15), "it stands on its feet"  # masses are 5 % off at most
    assert thor.behavior == "stand_manipulate"


def test_the_lidar_turns_at_its_speed(thor: Thor) -> None:
    """Whatever Motor says; by the servo's own word, from a robot's time to another."""
    servo = next(s for d in ROBOT.tables.devices.values() if isinstance(d, Dynamixel) for s in d.servos if s.spin)
    place = ROBOT.index[servo.joint]
    first = last = thor.measured()
    turned = 0.0
    while last.time < first.time + 1_500_000_000:
        following = thor.measured()
        turned += math.remainder(following.joint_position[place] - last.joint_position[place], 2.0 * math.pi)
        last = following
    assert turned / (1e-9 * (last.time - first.time)) == pytest.approx(servo.spin, rel=0.2)


def test_a_robot_whose_imu_is_unplugged_stands_by_the_other_one(thor: Thor) -> None:
    """And by the first again when the other one is gone, too; without any it is held."""
    fault = FAULT.client(thor.node)

    def fail(device: str, kind: str) -> None:
        reply = fault.call(FaultRequest(device, device, kind, 0.0), timeout=PATIENCE)
        assert reply.accepted, reply.reason

    def unit(name: str) -> tuple[str, str]:
        status = thor.status
        place = status.units.index(name)
        return status.states[place], status.details[place]

    def heading() -> float:
        w, x, y, z = thor.measured().imu_orientation
        return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))

    wait_until(lambda: (unit("imu"), unit("kvh")) == (("ok", "leads"), ("ok", "stands by")), PATIENCE, "both are well")
    thor.go("stand")
    before = heading()
    fail("imu", "unplugged")
    wait_until(lambda: unit("kvh") == ("ok", "leads"), PATIENCE, "the other one leads")
    assert unit("imu")[0] == "unplugged" and unit("imu")[1].endswith("(kvh leads)")
    assert thor.status.reaction == "keep_balance"
    assert heading() == pytest.approx(before, abs=0.02)
    standing = thor.state.time
    wait_until(lambda: thor.state.time > standing + 2_000_000_000, PATIENCE, "two seconds of the robot")
    assert thor.behavior == "stand", thor.state.reason
    fail("imu", "")
    wait_until(lambda: unit("imu") == ("ok", "stands by"), PATIENCE, "it is found again")
    fail("kvh", "silent")
    wait_until(lambda: unit("imu") == ("ok", "leads"), PATIENCE, "the first leads again")
    assert thor.behavior == "stand", thor.state.reason
    fail("imu", "silent")
    wait_until(lambda: thor.behavior == "freeze", PATIENCE, "without any the joints are held")
    assert thor.state.reason.startswith(("imu: no sound state", "kvh: no sound state"))
    for device in ("imu", "kvh"):
        fail(device, "")
    wait_until(lambda: thor.status.reaction == "keep_balance", PATIENCE, "both are well")


def test_legs_that_lost_their_power_for_a_moment_have_the_robot_go_limp(thor: Thor) -> None:
    """The last one: it lies afterwards. Nobody was silent; the first that is off has it held, the second lets it go."""
    thor.go("stand")
    fault = FAULT.client(thor.node)
    legs = [unit for unit in thor.status.units if unit.startswith("legs/")]
    for unit in legs[:4]:
        reply = fault.call(FaultRequest("legs", unit.removeprefix("legs/"), "unplugged", 0.05), timeout=PATIENCE)
        assert reply.accepted, reply.reason
    wait_until(lambda: thor.behavior == "fall", PATIENCE, "it falls")
    assert "its motors are off: it had lost its power" in thor.state.reason
    assert "without motors: the robot goes limp" in thor.running.log("comms_manager")

    def on_again() -> bool:
        status = thor.status
        return all(status.states[status.units.index(unit)] == "ok" for unit in legs)

    wait_until(on_again, PATIENCE, "its motors are on again, as limp moves nothing")
    wait_until(lambda: thor.status.reaction == "keep_balance", PATIENCE, "nothing more is demanded")
    assert thor.behavior == "fall"
