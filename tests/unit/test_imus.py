"""IMUs of either make on a pseudo-terminal: what goes wrong with one, and with its driver's start."""

from __future__ import annotations

import fcntl
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest
from msgspec.structs import replace

from harness.device_bench import UNSOUND, Bench, at_work, reported_fault, sound
from harness.places import ROBOTS
from harness.waiting import some, wait_until
from valor.comms_manager.hardware.device import DeviceError, Fault, ImuMeasurement
from valor.comms_manager.hardware.microstrain import MicroStrain
from valor.device_emulators.emulator import EmulatedFault
from valor.robot.description import RobotDescription

ESCHER = RobotDescription.load(ROBOTS / "escher")


def altered(name: str, **keys: object) -> RobotDescription:
    """ESCHER with other values in the table of one of its IMUs."""
    devices = {**ESCHER.tables.devices, name: replace(ESCHER.tables.devices[name], **keys)}
    return RobotDescription(ESCHER.folder, replace(ESCHER.tables, devices=devices))


@pytest.fixture(params=["imu", "kvh"])
def bench(home: Path, request: pytest.FixtureRequest) -> Iterator[Bench]:
    bench = Bench(altered(request.param), request.param, home)
    yield bench
    bench.close()


@pytest.mark.parametrize("fault", UNSOUND)
def test_nothing_of_a_sick_sensor_is_accepted_until_it_is_well(bench: Bench, fault: EmulatedFault) -> None:
    with bench.running() as driver:
        sound(driver)
        bench.inject(bench.device, fault)
        looks, record = driver.looks, driver.records[0]  # what came before the fault is yet to be read
        wait_until(lambda: driver.looks > looks + 5 and time.monotonic_ns() - record.stamp > 1e8, 10, "silence")
        before, now = record.states, bench.robot.time
        wait_until(lambda: bench.robot.time > now + 0.1, 10, "the sensor has measured on")
        assert record.states == before and (record.errors > 0) is (fault is not EmulatedFault.SILENT)
        bench.heal()
        sound(driver)


def test_what_comes_twice_is_accepted_once(bench: Bench) -> None:
    with bench.running() as driver:
        sound(driver)
        bench.inject(bench.device, EmulatedFault.DUPLICATE)
        record = driver.records[0]
        wait_until(lambda: record.errors >= 20, 10, "refused packets")
        states, errors = record.states, record.errors
        wait_until(lambda: record.errors >= errors + 20, 10, "refused packets")
        assert abs((record.states - states) - (record.errors - errors)) <= 2


def test_an_unplugged_sensor_is_reported_and_found_again(bench: Bench) -> None:
    with bench.running() as driver:
        sound(driver)
        bench.inject(bench.device, EmulatedFault.UNPLUGGED)
        assert "gone" in reported_fault(driver, bench.device, Fault.UNPLUGGED).detail
        bench.heal()
        before = driver.attitude
        sound(driver)
        wait_until(lambda: driver.attitude is not before, 10, "it knows its attitude again")


@pytest.mark.parametrize(
    ("bench", "table", "message"),
    [
        ("imu", {"model": "3DM-GX5-25"}, "imu: model '3DM-GX4-25'; expected '3DM-GX5-25'"),
        ("imu", {"serial": "6234.1"}, "imu: serial number '6234.40117'; expected '6234.1'"),
        ("imu", {"firmware": "1.1.25"}, "imu: firmware '1.1.26'; expected '1.1.25'"),
        ("imu", {"rate": 300}, "imu: rate 300 Hz .*a whole fraction of its 500 Hz"),
        ("kvh", {"serial": "7"}, "kvh: serial number '1750-0042'; expected '7'"),
    ],
    indirect=["bench"],
)
def test_another_sensor_is_rejected(bench: Bench, table: dict[str, object], message: str) -> None:
    driver = bench.driver(altered(bench.device, **table))
    with pytest.raises(DeviceError, match=message):
        driver.find()
    driver.close()


@pytest.mark.parametrize(
    ("bench", "fault", "message"),
    [
        ("imu", EmulatedFault.SILENT, "imu: no answer .*expected a 3DM-GX4-25 with serial number"),
        ("imu", EmulatedFault.BAD_CHECKSUM, "imu: no answer"),
        ("imu", EmulatedFault.UNPLUGGED, "imu: .*cannot be opened.*expected a 3DM-GX4-25"),
        ("kvh", EmulatedFault.SILENT, "kvh: no answer within 1 s; expected a KVH 1750 with serial number 1750-0042"),
        ("kvh", EmulatedFault.UNPLUGGED, "kvh: .*cannot be opened.*expected a KVH 1750 with serial number 1750-0042"),
    ],
    indirect=["bench"],
)
def test_start_is_rejected_without_a_sensor(bench: Bench, fault: EmulatedFault, message: str) -> None:
    bench.inject(bench.device, fault)
    wait_until(lambda: fault is not EmulatedFault.UNPLUGGED or not list(bench.instance.ports.iterdir()), 5, "unplugged")
    driver = bench.driver()
    with pytest.raises(DeviceError, match=message):
        driver.find()
    driver.close()


IMU = pytest.mark.parametrize("bench", ["imu"], indirect=True)


@IMU
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


@IMU
def test_what_lay_here_unread_is_not_the_sensors_delay(bench: Bench) -> None:
    """A computer that does not come to read for a while finds all packets there, the newest of them fresh."""
    driver = bench.driver()
    driver.find()
    record, looks = driver.records[0], driver.looks
    before, errors = record.states, record.errors
    time.sleep(0.15)  # the main loop does not get its turn: that is the subject of this test
    asked = time.monotonic_ns()
    driver._listen(0.1)  # type: ignore[attr-defined]
    assert record.states >= before + 5 and record.errors == errors
    assert driver.looks == looks + 1
    assert record.stamp > asked
    driver.close()


@IMU
def test_what_came_while_other_devices_were_found_is_not_taken_for_late(bench: Bench) -> None:
    driver = bench.driver()
    driver.find()
    assert isinstance(driver, MicroStrain)
    port = some(driver._port)

    def waiting() -> int:
        return int.from_bytes(fcntl.ioctl(port.fileno(), termios.FIONREAD, bytes(4)), "little")

    wait_until(lambda: waiting() > 2000, 10, "twenty-five samples that nobody fetched")
    with at_work(driver):
        before = driver.records[0].states
        wait_until(lambda: driver.records[0].states >= before + 10, 10, "ten samples")
        assert driver.records[0].errors <= 1, "the one that was cut in two, at most"
