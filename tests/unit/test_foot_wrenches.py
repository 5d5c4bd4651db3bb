"""Wrenches of the feet of a robot without sensors in them, against those that the ground exerts."""

import numpy as np
import pytest
from msgspec import structs

from harness.closed_loop import ClosedLoop, load_robot
from harness.foot_sensors import with_foot_sensors
from valor.common.messages import Proprioceptor
from valor.robot.description import RobotDescription
from valor.robot.foot_wrenches import LONGEST_GAP, Unsensed
from valor.whole_body.walking.velocity_steps import VelocitySteps

SENSED = load_robot()
BARE = with_foot_sensors(SENSED, sensed=False)
GRAVITY = 9.81


def wrenches(measured: Proprioceptor) -> np.ndarray:
    return np.array((measured.left_foot_wrench, measured.right_foot_wrench))


def walked(robot: RobotDescription, seconds: float) -> tuple[ClosedLoop, list[Proprioceptor]]:
    """Measurements of a robot that stands, then walks."""
    loop = ClosedLoop(robot, "hardware")
    measured: list[Proprioceptor] = []
    measure = loop.sensors.measure

    def noted(sequence: int, time: int) -> Proprioceptor:
        measured.append(measure(sequence, time))
        return measured[-1]

    loop.sensors.measure = noted  # type: ignore[method-assign]
    loop.settle(0.3)
    loop.run(1.0)
    source = loop.request.steps = VelocitySteps(robot.tables.walking)
    until = loop.time + seconds
    while loop.time < until:
        source.command(np.array((0.3, 0.0, 0.0)), loop.time)
        source.advance(loop.time)
        loop.step()
    return loop, measured


@pytest.fixture(scope="module")
def walk() -> list[Proprioceptor]:
    """Measurements with force/torque sensors in the feet."""
    return walked(SENSED, 2.5)[1]


def test_estimates_are_near_the_sensors(walk: list[Proprioceptor]) -> None:
    unsensed = Unsensed(BARE)
    estimated = np.array([wrenches(unsensed.completed(m)) for m in walk])
    true = np.array([wrenches(m) for m in walk])
    weight = SENSED.tables.size.mass * GRAVITY
    stands, swings = np.minimum(true, estimated)[..., 2] > 0.3 * weight, true[..., 2] < 0.01 * weight
    assert swings.sum() > 200 and not estimated[swings][:, 2].any(), "a foot in the air carries nothing"
    assert np.sqrt(np.mean(np.square(estimated - true)[stands][:, 2])) < 0.05 * weight
    for moment in (3, 4):  # by the force: the centre of pressure
        cop, expected = (each[stands][:, moment] / each[stands][:, 2] for each in (estimated, true))
        assert np.sqrt(np.mean(np.square(cop - expected))) < 0.012


def test_it_starts_anew_after_a_gap_and_on_a_straight_leg_stays_finite(walk: list[Proprioceptor]) -> None:
    unsensed, measured = Unsensed(BARE), walk[400]
    for m in walk[:300]:
        unsensed.completed(m)
    late = structs.replace(measured, time=measured.time + 2 * LONGEST_GAP)
    np.testing.assert_array_equal(wrenches(unsensed.completed(late)), wrenches(Unsensed(BARE).completed(late)))
    straight = structs.replace(measured, joint_position=np.zeros_like(measured.joint_position))
    assert np.abs(wrenches(Unsensed(BARE).completed(straight))).max() < 5.0 * SENSED.tables.size.mass * GRAVITY


def test_it_walks_with_neither_foot_sensors_nor_an_accelerometer() -> None:
    imu = structs.replace(BARE.tables.imu, accelerometer=False)
    robot = RobotDescription(BARE.folder, structs.replace(BARE.tables, imu=imu))
    loop, measured = walked(robot, 2.5)
    assert loop.fall is None and loop.plant.data.qpos[0] > 0.2
    assert {round(float(np.linalg.norm(m.imu_linear_acceleration)), 6) for m in measured} == {GRAVITY}


def test_sensors_are_in_both_feet_or_in_neither() -> None:
    BARE.require_devices()
    assert SENSED.tables.feet_are_sensed and not BARE.tables.feet_are_sensed
