"""Proprioceptor of the measurements of all devices."""

import math
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from harness.device_bench import StillDevice
from harness.examples import examples
from harness.places import ROBOTS
from valor.common.errors import ConfigurationError
from valor.common.rotation import about_z, multiply
from valor.comms_manager.hardware.device import ImuMeasurement, Part, WrenchMeasurement
from valor.comms_manager.hardware.proprioception import FRESH, AttitudeSource, Proprioception
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(ROBOTS / "escher")
Angle = st.floats(-math.pi, math.pi)


def test_wrenches_belong_to_their_places() -> None:
    devices = [StillDevice(name, ROBOT) for name in ROBOT.tables.devices]
    ROBOT.require_devices()
    sensors = next(device for device in devices if device.name == "force_torque")
    assert [sensors.part(record.unit) for record in sensors.records] == [Part.FOOT, Part.FOOT, Part.HAND, Part.HAND]
    senses = Proprioception(ROBOT, devices)
    sensors.wrench = WrenchMeasurement(np.ones(4, dtype=np.int64), np.outer(np.arange(1.0, 5.0), np.ones(6)))
    state = senses.measure(7, 8, 9, None)
    assert (state.time, state.sequence, state.motor_sequence) == (7, 8, 9)
    for row, place in enumerate(sensors.places, 1):
        assert (getattr(state, f"{place}_wrench") == row).all()


def test_what_none_or_two_provide_is_reported() -> None:
    devices = {**ROBOT.tables.devices, "twice": ROBOT.tables.devices["force_torque"]}
    del devices["imu"], devices["kvh"], devices["neck"]
    robot = RobotDescription(ROBOT.folder, structs.replace(ROBOT.tables, devices=devices))
    with pytest.raises(ConfigurationError) as raised:
        robot.require_devices()
    assert str(raised.value).endswith(
        ": devices: none moves neck_yaw, neck_pitch, lidar_roll; 0 IMUs; expected one, for the pelvis' "
        "attitude; left_foot, right_foot, left_hand, right_hand: in more than one device"
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
def test_who_takes_over_goes_on_at_the_heading_before(first: float, second: float, roll: float, turned: float) -> None:
    """By how much headings differ is known from when both were received; the robot has turned since."""
    imu, kvh = StillDevice("imu", ROBOT), StillDevice("imu", ROBOT)
    source = AttitudeSource([imu, kvh])
    imu.attitude, kvh.attitude = sample(first, roll), sample(second, roll)
    assert source.measure(imu) is imu.attitude
    kvh.attitude = sample(second + turned, roll)
    assert same(source.measure(kvh), sample(first + turned, roll))
    imu.attitude = sample(0.0, roll)  # it was restarted, and its heading is another one
    source.measure(kvh)
    assert same(source.measure(imu), sample(first + turned, roll))


def test_a_heading_that_is_old_is_compared_with_none() -> None:
    imu, kvh = StillDevice("imu", ROBOT), StillDevice("imu", ROBOT)
    source = AttitudeSource([imu, kvh])
    imu.attitude, kvh.attitude = sample(0.5, 0.0), sample(0.0, 0.0)
    source.measure(imu)
    kvh.attitude = sample(1.0, 0.0)
    imu.attitude = sample(0.5, 0.0, age=2e-9 * FRESH)
    source.measure(imu)
    assert same(source.measure(kvh), sample(1.5, 0.0))


def test_before_the_first_sample_it_stands_upright() -> None:
    imu = StillDevice("imu", ROBOT)
    assert AttitudeSource([imu]).measure(imu).orientation.tolist() == [1.0, 0.0, 0.0, 0.0]
