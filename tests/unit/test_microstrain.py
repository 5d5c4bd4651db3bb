"""The IMU's driver and emulator on a pseudo-terminal, sound and with every fault."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest
from msgspec.structs import replace

from harness.device_bench import UNSOUND, Bench, ailing, sound
from harness.places import ROBOTS
from harness.waiting import wait_until
from valor.comms_manager.hardware.device import DeviceError, Fault, ImuMeasurement
from valor.comms_manager.hardware.microstrain import MicroStrain
from valor.device_emulators.emulator import EmulatedFault
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(ROBOTS / "escher")


@pytest.fixture
def bench(home: Path) -> Iterator[Bench]:
    bench = Bench(ROBOT, "imu", home)
    yield bench
    bench.close()


def altered(**imu: object) -> RobotDescription:
    """ESCHER with another IMU in its table."""
    devices = dict(ROBOT.tables.devices)
    devices["imu"] = replace(devices["imu"], **imu)
    return RobotDescription(ROBOT.folder, replace(ROBOT.tables, devices=devices))


def test_what_the_robot_feels_arrives(bench: Bench) -> None:
    """Tilted, turning, standing still: the emulator turns it into the vendor's frames, the driver back."""
    tilt = np.zeros(4)
    mujoco.mju_euler2Quat(tilt, np.array([0.3, -0.2, 1.1]), "xyz")
    with bench.lock:
        plant = bench.robot.plant
        plant.data.qpos[3:7] = tilt
        plant.data.qvel[3:6] = (0.4, -0.3, 0.2)
        mujoco.mj_forward(plant.model.mj, plant.data)
        bench.robot._measured = None
        felt = bench.robot.measured
    with bench.running() as driver:
        sound(driver)
        measured = driver.attitude
        assert isinstance(measured, ImuMeasurement)
        assert abs(measured.orientation @ tilt) == pytest.approx(1.0, abs=1e-6)
        np.testing.assert_allclose(measured.angular_velocity, felt.imu_angular_velocity, atol=1e-5)
        np.testing.assert_allclose(measured.linear_acceleration, felt.imu_linear_acceleration, atol=1e-4)


def test_samples_come_at_the_rate_of_the_table(bench: Bench) -> None:
    began = time.monotonic()
    with bench.running() as driver:
        wait_until(lambda: driver.records[0].states >= 100, 10, "a hundred samples")
        assert driver.records[0].states < 1.1 * 250 * (time.monotonic() - began) + 1
        assert driver.records[0].errors == 0


def test_what_came_while_other_devices_were_found_is_not_taken_for_late(bench: Bench) -> None:
    driver, stopping = bench.driver(), threading.Event()
    driver.find()
    assert isinstance(driver, MicroStrain) and driver._port is not None
    wait_until(lambda: driver._port.in_waiting > 2000, 10, "twenty-five samples that nobody fetched")
    thread = threading.Thread(target=driver.run, args=(stopping,))
    thread.start()
    try:
        before = driver.records[0].states
        wait_until(lambda: driver.records[0].states >= before + 10, 10, "ten samples")
        assert driver.records[0].errors <= 1, "the one that was cut in two, at most"
    finally:
        stopping.set()
        thread.join()
        driver.close()


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"model": "3DM-GX5-25"}, "imu: model '3DM-GX4-25'; expected '3DM-GX5-25'"),
        ({"serial": "6234.1"}, "imu: serial number '6234.40117'; expected '6234.1'"),
        ({"firmware": "1.1.25"}, "imu: firmware '1.1.26'; expected '1.1.25'"),
        ({"rate": 300}, "imu: rate 300 Hz .*a whole fraction of its 500 Hz"),
    ],
)
def test_another_sensor_is_refused(bench: Bench, table: dict[str, object], message: str) -> None:
    driver = bench.driver(altered(**table))
    with pytest.raises(DeviceError, match=message):
        driver.find()
    driver.close()


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (EmulatedFault.SILENT, "imu: no answer .*expected a 3DM-GX4-25 with serial number"),
        (EmulatedFault.BAD_CHECKSUM, "imu: no answer"),
        (EmulatedFault.UNPLUGGED, "imu: .*cannot be opened.*expected a 3DM-GX4-25"),
    ],
)
def test_start_is_refused_without_a_sensor(bench: Bench, fault: EmulatedFault, message: str) -> None:
    bench.inject("imu", fault)
    wait_until(lambda: fault is not EmulatedFault.UNPLUGGED or not list(bench.instance.ports.iterdir()), 5, "unplugged")
    driver = bench.driver()
    with pytest.raises(DeviceError, match=message):
        driver.find()
    driver.close()


@pytest.mark.parametrize("fault", UNSOUND)
def test_nothing_of_a_sick_sensor_is_believed_and_it_is_used_again_when_well(
    bench: Bench, fault: EmulatedFault
) -> None:
    with bench.running() as driver:
        sound(driver)
        bench.inject("imu", fault)
        looks, record = driver.looks, driver.records[0]  # what came before the fault is yet to be read
        wait_until(lambda: driver.looks > looks + 5 and time.monotonic_ns() - record.stamp > 1e8, 10, "silence")
        before, now = driver.records[0].states, bench.robot.time
        wait_until(lambda: bench.robot.time > now + 0.1, 10, "the sensor has measured on")
        assert driver.records[0].states == before
        assert (driver.records[0].errors > 0) is (fault is not EmulatedFault.SILENT)
        bench.heal()
        sound(driver)


def test_what_comes_twice_is_taken_once(bench: Bench) -> None:
    with bench.running() as driver:
        sound(driver)
        bench.inject("imu", EmulatedFault.DUPLICATE)
        wait_until(lambda: driver.records[0].errors >= 20, 10, "refused packets")
        states, errors = driver.records[0].states, driver.records[0].errors
        wait_until(lambda: driver.records[0].errors >= errors + 20, 10, "refused packets")
        assert abs((driver.records[0].states - states) - (driver.records[0].errors - errors)) <= 2


def test_a_slow_sensor_is_heard_seldom(bench: Bench) -> None:
    with bench.running() as driver:
        sound(driver)
        bench.inject("imu", EmulatedFault.SLOW)
        sound(driver)
        before, began = driver.records[0].states, time.monotonic()
        wait_until(lambda: driver.records[0].states >= before + 10, 10, "ten samples")
        assert 10 / (time.monotonic() - began) < 0.5 * driver.rate


def test_an_unplugged_sensor_is_told_of_and_found_again(bench: Bench) -> None:
    with bench.running() as driver:
        sound(driver)
        bench.inject("imu", EmulatedFault.UNPLUGGED)
        assert "gone" in ailing(driver, "imu", Fault.UNPLUGGED).detail
        bench.heal()
        sound(driver)


def test_what_lay_here_unread_is_not_the_sensors_delay(bench: Bench) -> None:
    """A computer that does not come to read for a while finds all packets there, the newest of them fresh."""
    driver = bench.driver()
    driver.find()
    record, looks = driver.records[0], driver.looks
    before, errors = record.states, record.errors
    time.sleep(0.15)  # the thread does not get its turn: that is the subject of this test
    asked = time.monotonic_ns()
    driver._listen(0.1)  # type: ignore[attr-defined]
    assert record.states >= before + 5 and record.errors == errors
    assert driver.looks == looks + 1
    assert record.stamp > asked
    driver.close()
