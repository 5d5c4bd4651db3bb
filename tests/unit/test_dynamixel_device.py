"""The head's servos: driver and emulator on a pseudo-terminal, sound and with every fault."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from harness.device_bench import UNSOUND, Bench, reported_fault, sound
from harness.places import ROBOTS
from harness.waiting import wait_until
from valor.common.messages import JointMode
from valor.comms_manager.hardware.device import Device, DeviceError, Fault, JointCommands, JointMeasurement
from valor.device_emulators.emulator import EmulatedFault
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(ROBOTS / "escher")
YAW, PITCH, LIDAR = range(3)


@pytest.fixture
def bench(home: Path) -> Iterator[Bench]:
    bench = Bench(ROBOT, "neck", home, moves=True)
    yield bench
    bench.close()


def altered(row: int, **servo: object) -> RobotDescription:
    table: Any = ROBOT.tables.devices["neck"]
    servos = [replace(each, **servo) if i == row else each for i, each in enumerate(table.servos)]
    devices = ROBOT.tables.devices | {"neck": replace(table, servos=servos)}
    return RobotDescription(ROBOT.folder, replace(ROBOT.tables, devices=devices))


def send(driver: Device, *position: float, mode: JointMode = JointMode.POSITION) -> None:
    zero = np.zeros(3)
    driver.send(JointCommands(1, np.full(3, mode, dtype=np.uint8), np.array([*position, 0.0]), zero, zero, zero, zero))


def position(driver: Device, row: int) -> float:
    measured = driver.joint_state
    assert isinstance(measured, JointMeasurement)
    return float(measured.position[row])


def comes_to(driver: Device, row: int, angle: float, within: float = 0.06) -> None:
    wait_until(lambda: abs(position(driver, row) - angle) < within, 10, f"joint {row} at {angle:g} rad")


@pytest.fixture
def driver(bench: Bench) -> Iterator[Device]:
    """Of a head that looks to its left."""
    with bench.running() as driver:
        send(driver, 0.4, 0.0)
        comes_to(driver, YAW, 0.4)
        yield driver


def test_the_head_goes_where_it_is_sent_and_says_where_it_is(bench: Bench) -> None:
    with bench.running() as driver:
        send(driver, 0.5, 0.3)
        comes_to(driver, YAW, 0.5)
        comes_to(driver, PITCH, 0.3)
        with bench.lock:
            truth = bench.robot.plant.joint_position[driver.joints]
        assert abs(position(driver, YAW) - truth[YAW]) < 0.1 and driver.unit_faults == ()


def test_it_goes_no_faster_than_the_joint_may(bench: Bench) -> None:
    with bench.running() as driver:
        sound(driver)
        began = time.monotonic()
        send(driver, 1.2, 0.0)
        comes_to(driver, YAW, 1.2)
        assert time.monotonic() - began > 0.8 * 1.14 / 6.0


def test_the_lidar_spins_at_the_speed_of_the_table(bench: Bench) -> None:
    """In the robot's time, however slowly that passes on a busy computer."""

    def look() -> tuple[float, float]:
        with bench.lock:
            return bench.robot.time, float(bench.robot.plant.joint_position[ROBOT.index["lidar_roll"]])

    with bench.running() as driver:
        wait_until(lambda: driver.records[LIDAR].states > 5, 10, "states")
        start = look()[0]
        wait_until(lambda: look()[0] > start + 0.3, 20, "the lidar at its speed")
        first = look()
        wait_until(lambda: look()[0] > first[0] + 1.0, 20, "a second of the robot's")
        last = look()
        assert (last[1] - first[1]) / (last[0] - first[0]) == pytest.approx(1.0, rel=0.05)
        assert abs(position(driver, LIDAR)) <= math.pi and driver.unit_faults == ()


@pytest.mark.parametrize(
    ("row", "servo", "message"),
    [
        (YAW, {"id": 9}, "neck/neck_yaw: servo 9: no answer to a ping; expected a XM540-W270"),
        (PITCH, {"model": "MX-64"}, r"neck/neck_pitch: model 'XM540-W270'; expected 'MX-64' \(robot.yaml\)"),
        (LIDAR, {"firmware": 45}, r"neck/lidar_roll: firmware 46; expected 45 \(robot.yaml\)"),
        (YAW, {"zero": 2048}, r"neck/neck_yaw: at 0.035 rad; expected 0.000 ± 0.02 .*zero 2048"),
    ],
)
def test_another_servo_is_rejected(bench: Bench, row: int, servo: dict[str, object], message: str) -> None:
    expecting = altered(row, **servo)
    strict = replace(expecting.tables, calibration=replace(expecting.tables.calibration, tolerance=0.02))
    driver = bench.driver(RobotDescription(ROBOT.folder, strict))
    with pytest.raises(DeviceError, match=message):
        driver.find()
    driver.close()


@pytest.mark.parametrize("fault", UNSOUND)
def test_nothing_of_a_sick_servo_is_accepted_and_the_others_continue(bench: Bench, fault: EmulatedFault) -> None:
    with bench.running() as driver:
        sound(driver)
        bench.inject("neck_yaw", fault)
        wait_until(lambda: time.monotonic_ns() - driver.records[YAW].stamp > 3e8, 10, "silence")
        before = driver.records[PITCH].states
        wait_until(lambda: driver.records[PITCH].states > before + 5, 10, "the other's states")
        if fault in (EmulatedFault.GARBAGE, EmulatedFault.BAD_CHECKSUM):  # what is late is not even heard
            wait_until(lambda: driver.records[YAW].errors > 0, 10, "errors counted")
        bench.heal()
        sound(driver, YAW)


@pytest.mark.parametrize("unit", ["neck_yaw", "port"])
def test_a_servo_without_power_and_an_unplugged_adapter_are_found_again(bench: Bench, unit: str) -> None:
    with bench.running() as driver:
        send(driver, 0.4, 0.2)
        comes_to(driver, YAW, 0.4)
        bench.inject(unit, EmulatedFault.UNPLUGGED)
        if unit == "port":
            assert "gone" in reported_fault(driver, "neck_pitch", Fault.UNPLUGGED).detail
        else:
            wait_until(lambda: time.monotonic_ns() - driver.records[YAW].stamp > 3e8, 10, "silence")
            comes_to(driver, PITCH, 0.2)
        bench.heal()
        for row in range(3):
            sound(driver, row)
        comes_to(driver, YAW, 0.4)
        send(driver, -0.3, 0.0)
        comes_to(driver, YAW, -0.3)


def test_a_servo_that_is_too_hot_lets_go_and_is_used_again_when_it_is_cool(bench: Bench, driver: Device) -> None:
    bench.inject("neck_pitch", EmulatedFault.OVER_TEMPERATURE)
    assert "90 °C; expected less than 80 °C" in reported_fault(driver, "neck_pitch", Fault.HOT).detail
    reported_fault(driver, "neck_pitch", Fault.DISABLED)
    assert driver.records[PITCH].temperature == 90.0
    bench.heal()
    sound(driver, PITCH)
    send(driver, 0.4, 0.3)
    comes_to(driver, PITCH, 0.3)


def test_low_voltage_is_reported_and_switches_nothing_off(bench: Bench, driver: Device) -> None:
    """Low voltage raises the alarm by a servo's defaults, but does not shut the servo down."""
    bench.inject("neck_yaw", EmulatedFault.UNDER_VOLTAGE)
    assert "10.0 V; expected more than 10.5 V" in reported_fault(driver, "neck_yaw", Fault.LOW_VOLTAGE).detail
    bench.heal()
    sound(driver)
    with bench.lock:
        servo = bench.emulator._servos[YAW].servo  # type: ignore[attr-defined]
        servo.set(servo.model.table.hardware_error, 0x01)
    reported_fault(driver, "neck_yaw", Fault.FAULTY)
    before = driver.records[YAW].states
    wait_until(lambda: driver.records[YAW].states > before + 40, 10, "a second of states")
    assert [each.fault for each in driver.unit_faults] == [Fault.FAULTY]
    with bench.lock:
        assert servo.torque
    send(driver, 0.1, 0.0)
    comes_to(driver, YAW, 0.1)


def test_an_encoder_that_jumps_is_not_accepted_and_its_joint_stays(bench: Bench, driver: Device) -> None:
    bench.inject("neck_yaw", EmulatedFault.ENCODER_JUMP)
    reported_fault(driver, "neck_yaw", Fault.ENCODER)
    assert abs(position(driver, YAW) - 0.4) < 0.1
    send(driver, -0.4, 0.2)
    comes_to(driver, PITCH, 0.2)
    with bench.lock:
        truth = float(bench.robot.plant.joint_position[driver.joints[YAW]])
    assert abs(truth - 0.4) < 0.45  # it went neither to where the encoder nor to where the command would have it


def test_off_is_off(bench: Bench, driver: Device) -> None:
    send(driver, 0.4, 0.0, mode=JointMode.OFF)
    place = int(driver.joints[YAW])

    def limp() -> bool:
        with bench.lock:
            return not bench.robot._powered[place]

    wait_until(limp, 5, "the servo off")
    before = driver.records[YAW].states
    wait_until(lambda: driver.records[YAW].states > before + 5, 10, "states")
    assert driver.unit_faults == ()  # it is off because it shall be
    send(driver, 0.1, 0.0)
    comes_to(driver, YAW, 0.1)
