"""The KVH 1750's driver and emulator on a pseudo-terminal; `test_imus.py` has what goes wrong."""

from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest

from harness.device_bench import Bench, reported_fault, sound
from harness.waiting import wait_until
from tests.unit.test_imus import altered
from valor.comms_manager.hardware.device import Device, Fault, ImuMeasurement
from valor.device_emulators.emulator import EmulatedFault


@pytest.fixture
def bench(home: Path) -> Iterator[Bench]:
    bench = Bench(altered("kvh"), "kvh", home)
    yield bench
    bench.close()


def newest(driver: Device) -> ImuMeasurement:
    assert driver.attitude is not None
    return driver.attitude


def test_what_the_robot_feels_arrives_and_becomes_an_attitude(bench: Bench) -> None:
    """At rest it is tilted as gravity requires; then it goes with its rates, but for its heading, which begins at 0."""

    def feel(roll: float, pitch: float, yaw: float, rate: tuple[float, float, float]) -> np.ndarray:
        pose = np.zeros(4)
        mujoco.mju_euler2Quat(pose, np.array([roll, pitch, yaw]), "xyz")
        with bench.lock:
            plant = bench.robot.plant
            plant.data.qpos[3:7], plant.data.qvel[3:6] = pose, rate
            mujoco.mj_forward(plant.model.mj, plant.data)
            bench.robot._measured = None
        return pose

    tilt = feel(0.2, -0.1, 0.0, (0.0, 0.0, 0.0))
    with bench.running() as driver:
        sound(driver)
        found = newest(driver).orientation
        up = np.zeros(3)
        for attitude in (tilt, found):
            mujoco.mju_rotVecQuat(up, np.array([0.0, 0.0, 1.0]), attitude * [1, -1, -1, -1])
            np.testing.assert_allclose(up, [0.1, 0.2, 0.97], atol=0.02)
        np.testing.assert_allclose(newest(driver).linear_acceleration, bench.robot.measured.imu_linear_acceleration)
        feel(0.2, -0.1, 0.0, (0.4, -0.3, 0.2))
        wait_until(lambda: abs(newest(driver).angular_velocity[0] - 0.4) < 1e-5, 10, "its rate")
        np.testing.assert_allclose(newest(driver).angular_velocity, [0.4, -0.3, 0.2], atol=1e-6)

        def turned() -> float:
            return float(2.0 * np.arccos(min(1.0, abs(float(found @ newest(driver).orientation)))))

        wait_until(lambda: turned() > 0.25, 10, "it has turned half a second or so")


def test_a_sensor_that_is_too_warm_reports_it(bench: Bench) -> None:
    with bench.running() as driver:
        sound(driver)
        bench.inject("kvh", EmulatedFault.OVER_TEMPERATURE)
        assert reported_fault(driver, "kvh", Fault.HOT).detail == "90 °C; expected less than 75 °C"
