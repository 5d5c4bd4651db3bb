"""Proprioceptor of what devices provide, whatever they are: kinds that the Comms Manager has never heard of."""

from __future__ import annotations

import math
import time
from pathlib import Path
from threading import Event

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from harness.examples import examples
from harness.places import ROBOTS
from valor.common.errors import ConfigurationError
from valor.common.instance import Instance, Settings
from valor.common.rotation import about_z, multiply
from valor.comms_manager.hardware.attitude import FRESH, AttitudeSource
from valor.comms_manager.hardware.device import (
    Device,
    DeviceContext,
    ImuMeasurement,
    Part,
    UnitRecord,
    WrenchMeasurement,
)
from valor.comms_manager.hardware.proprioception import Proprioception, require_complete
from valor.devices import kinds
from valor.devices.kinds import Kind, Quantity
from valor.devices.table import Device as DeviceTable
from valor.devices.table import WrenchPlace
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(ROBOTS / "escher")
SETTINGS = Settings(robot=ROBOT.folder, ros_domain_id=1)
Angle = st.floats(-math.pi, math.pi)


class Plate(DeviceTable, tag="plate"):
    """A force plate of a maker that nobody has heard of."""

    at: list[WrenchPlace]

    @property
    def places(self) -> list[WrenchPlace]:
        """Which it is under."""
        return self.at

    @property
    def units(self) -> list[str]:
        """As many."""
        return list(self.at)


class Still(Device):
    """A device that says what a test has it say."""

    def __init__(self, name: str, robot: RobotDescription) -> None:
        super().__init__(name, DeviceContext(Instance("x", Path()), SETTINGS, robot))
        self.records = tuple(UnitRecord(unit) for unit in self.context.robot.tables.devices[name].units or [name])

    def find(self) -> None:
        raise NotImplementedError

    def run(self, stopping: Event) -> None:
        raise NotImplementedError


@pytest.fixture
def plates(monkeypatch: pytest.MonkeyPatch) -> RobotDescription:
    """ESCHER with a plate under each foot in the place of its sensors."""
    row = Kind(Plate, Quantity.WRENCH, "nowhere:Plates", "nowhere:EmulatedPlates")
    monkeypatch.setattr(kinds, "KINDS", {**kinds.KINDS, row.name: row})
    monkeypatch.setattr("valor.comms_manager.hardware.device.KINDS", kinds.KINDS)
    devices = {**ROBOT.tables.devices, "force_torque": Plate(at=["right_foot", "left_foot"])}
    return RobotDescription(ROBOT.folder, structs.replace(ROBOT.tables, devices=devices))


def test_a_kind_that_is_new_gives_its_wrenches_to_their_places(plates: RobotDescription) -> None:
    devices = [Still(name, plates) for name in plates.tables.devices]
    require_complete(plates, devices)
    plate = next(device for device in devices if device.name == "force_torque")
    assert plate.part("left_foot") is plate.part("right_foot") is Part.FOOT
    senses = Proprioception(plates, devices)
    plate.wrench = WrenchMeasurement(np.ones(2, dtype=np.int64), np.array([[1.0] * 6, [2.0] * 6]))
    state = senses.measure(7, 8, 9, None)
    assert (state.time, state.sequence, state.motor_sequence) == (7, 8, 9)
    assert (state.right_foot_wrench == 1.0).all() and (state.left_foot_wrench == 2.0).all()
    assert not state.left_hand_wrench.any() and not state.right_hand_wrench.any()


def test_what_none_or_two_provide_is_told(plates: RobotDescription) -> None:
    devices = {**plates.tables.devices, "plates": Plate(at=["left_foot"])}
    del devices["imu"], devices["neck"]
    robot = RobotDescription(plates.folder, structs.replace(plates.tables, devices=devices))
    with pytest.raises(ConfigurationError) as raised:
        require_complete(robot, [Still(name, robot) for name in devices])
    assert str(raised.value).endswith(
        "robot.yaml: devices: none moves neck_yaw, neck_pitch, lidar_roll; 0 IMUs; expected one, for the pelvis' "
        "attitude; left_foot: in more than one device"
    )


def sample(heading: float, roll: float, age: float = -60.0) -> ImuMeasurement:
    """Of a robot that leans [rad], so old [s]: fresh, however long this computer takes."""
    lean = (math.cos(0.5 * roll), math.sin(0.5 * roll), 0.0, 0.0)
    stamp = time.monotonic_ns() - round(1e9 * age)
    return ImuMeasurement(stamp, np.array(multiply(about_z(heading), lean)), np.zeros(3), np.zeros(3))


def same(a: ImuMeasurement, b: ImuMeasurement) -> bool:
    return abs(float(a.orientation @ b.orientation)) == pytest.approx(1.0, abs=1e-9)


@given(Angle, Angle, st.floats(-0.5, 0.5), Angle)
@examples(50)
def test_who_takes_over_goes_on_at_the_heading_of_the_one_before(
    first: float, second: float, roll: float, turned: float
) -> None:
    """By how much headings differ is known from when both were heard; the robot has turned since."""
    imu, kvh = Still("imu", ROBOT), Still("imu", ROBOT)
    source = AttitudeSource([imu, kvh])
    imu.attitude, kvh.attitude = sample(first, roll), sample(second, roll)
    assert source.measure(imu) is imu.attitude
    kvh.attitude = sample(second + turned, roll)
    assert same(source.measure(kvh), sample(first + turned, roll))
    imu.attitude = sample(0.0, roll)  # it was restarted, and its heading is another one
    source.measure(kvh)
    assert same(source.measure(imu), sample(first + turned, roll))


def test_a_heading_that_is_old_is_compared_with_none() -> None:
    imu, kvh = Still("imu", ROBOT), Still("imu", ROBOT)
    source = AttitudeSource([imu, kvh])
    imu.attitude, kvh.attitude = sample(0.5, 0.0), sample(0.0, 0.0)
    source.measure(imu)
    kvh.attitude = sample(1.0, 0.0)
    imu.attitude = sample(0.5, 0.0, age=2e-9 * FRESH)
    source.measure(imu)
    assert same(source.measure(kvh), sample(1.5, 0.0))


def test_before_the_first_sample_it_stands_upright() -> None:
    imu = Still("imu", ROBOT)
    assert AttitudeSource([imu]).measure(imu).orientation.tolist() == [1.0, 0.0, 0.0, 0.0]
