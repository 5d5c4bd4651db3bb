"""THOR on its devices: emulated motor controllers, sensors and Dynamixel arms on real ports."""

from __future__ import annotations

import math
import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import ROBOTS, RunningInstance, fresh_instance, wait_until
from valor_common.devices.table import Dynamixel
from valor_common.messages import (
    BehaviorReply,
    BehaviorRequest,
    DeviceStatus,
    JointSetpoints,
    MotionState,
    Proprioceptor,
)
from valor_common.robot import RobotDescription
from valor_common.topics import BEHAVIOR, DEVICES, JOINT_SETPOINTS, MOTION_STATE, PROPRIOCEPTOR

PATIENCE = 60.0  # [s]
ROBOT = RobotDescription.load(ROBOTS / "thor")
SPEED = 1.0  # of what is commanded [rad/s]
NEAR = 0.05  # what trajectory controllers allow a goal [rad]


class Thor:
    """The robot on its devices, and who commands it in the VRC's stead."""

    def __init__(self, running: RunningInstance) -> None:
        node = running.node()
        self.devices = node.subscriber(DEVICES.name, DeviceStatus)
        self._states = node.subscriber(MOTION_STATE.name, MotionState)
        self._measured = node.subscriber(PROPRIOCEPTOR.name, Proprioceptor)
        self._setpoints = node.publisher(JOINT_SETPOINTS.name, JointSetpoints)
        self._behavior = node.client(BEHAVIOR.name, BehaviorRequest, BehaviorReply)

    def state(self) -> MotionState:
        """The Motion Manager's next word."""
        received = self._states.receive(PATIENCE)
        assert received is not None
        return received.message

    def measured(self) -> Proprioceptor:
        """What the devices say next."""
        received = self._measured.receive(PATIENCE)
        assert received is not None
        return received.message

    def go(self, behavior: str) -> None:
        """To a behavior, by way of those that lead there: a busy computer may have had the robot held meanwhile."""
        before = {"freeze": "stand_prep", "idle": "stand_prep", "soft_stop": "stand", "stand_prep": "stand"}

        def there() -> bool:
            now = self.state().behavior
            if now != behavior:
                self._behavior.call(BehaviorRequest(before.get(now, behavior)), timeout=PATIENCE)
            return now == behavior

        wait_until(there, PATIENCE, behavior, period=0.1)

    def move(self, goal: Mapping[str, float]) -> None:
        """Lead joints to a goal, a set-point after the other, and wait until they are there."""
        places = [ROBOT.index[name] for name in goal]
        end = np.array(list(goal.values()))
        begin = self.measured().joint_position[places]
        began, duration = self.state().time, float(np.abs(end - begin).max()) / SPEED

        def there() -> bool:
            now = self.state().time
            share = min(1.0, 1e-9 * (now - began) / duration)
            still = np.zeros(end.size)
            self._setpoints.publish(JointSetpoints(now, list(goal), begin + share * (end - begin), still, still))
            return share == 1.0 and bool(np.abs(self.measured().joint_position[places] - end).max() < NEAR)

        wait_until(there, PATIENCE, f"{', '.join(goal)} at the goal", period=0.01)


@pytest.fixture(scope="module")
def thor(ros_domain: int) -> Iterator[Thor]:
    home = Path(tempfile.mkdtemp(prefix="valor-"))
    try:
        with fresh_instance(home, ros_domain) as running:
            running.configure(
                robot=ROBOT.folder, variant="hardware", control_rate=250.0, actuators="hardware",
                epoch=time.monotonic_ns(),
            )  # fmt: skip
            running.start("device_emulators")
            running.wait_ready("device_emulators", PATIENCE)
            for name in ("comms_manager", "motion_manager"):
                running.start(name)
            for name in ("comms_manager", "motion_manager"):
                running.wait_ready(name, PATIENCE)
            yield Thor(running)
    finally:
        shutil.rmtree(home, ignore_errors=True)


def test_every_device_is_found_and_the_robot_stands_reaches_and_grasps(thor: Thor) -> None:
    thor.go("stand")
    received = thor.devices.receive(PATIENCE)
    assert received is not None
    units = received.message.units
    for name, device in ROBOT.tables.devices.items():
        if isinstance(device, Dynamixel):
            assert [unit for unit in units if unit.startswith(name)] == [f"{name}/{s.joint}" for s in device.servos]
    assert {unit.split("/")[0] for unit in units} == set(ROBOT.tables.devices)
    thor.go("stand_manipulate")
    tables = ROBOT.tables
    thor.move({**tables.arm_presets["forward"]["right"], **tables.hand_presets["close"]["left"]})
    wrenches = thor.measured()
    weight = wrenches.left_foot_wrench[2] + wrenches.right_foot_wrench[2]
    assert weight == pytest.approx(65.0 * 9.81, rel=0.15), "it stands on its feet"  # masses are 5 % off at most
    assert thor.state().behavior == "stand_manipulate"


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
