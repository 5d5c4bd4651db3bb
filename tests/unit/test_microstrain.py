"""The IMU's driver and emulator on a pseudo-terminal; `test_imus.py` has what goes wrong."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest

from harness.device_bench import Bench, sound
from harness.places import ROBOTS
from harness.waiting import wait_until
from valor.comms_manager.hardware.device import ImuMeasurement
from valor.comms_manager.hardware.microstrain import MicroStrain
from valor.device_emulators.emulator import EmulatedFault
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(ROBOTS / "escher")


@pytest.fixture
def bench(home: Path) -> Iterator[Bench]:
    bench = Bench(ROBOT, "imu", home)
    yield bench
    bench.close()


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
    assert isinstance(driver, MicroStrain)
    port = driver._port
    assert port is not None
    wait_until(lambda: port.in_waiting > 2000, 10, "twenty-five samples that nobody fetched")
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


def test_a_slow_sensor_is_heard_seldom(bench: Bench) -> None:
    with bench.running() as driver:
        sound(driver)
        bench.inject("imu", EmulatedFault.SLOW)
        sound(driver)
        before, began = driver.records[0].states, time.monotonic()
        wait_until(lambda: driver.records[0].states >= before + 10, 10, "ten samples")
        assert 10 / (time.monotonic() - began) < 0.5 * driver.rate


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
