"""The estimator against the simulator's truth, which only the test may look at."""

from __future__ import annotations

from dataclasses import dataclass, field

import msgspec
import numpy as np
import pytest

from motion_manager.whole_body import FloatingBaseEstimator, RobotState, rotation
from motion_manager.whole_body.dynamics import Dynamics
from motion_manager.whole_body.estimator import Attitude
from tests.unit.whole_body.closed_loop import ClosedLoop
from tests.unit.whole_body.conftest import FloatArray
from valor_common.messages import Proprioceptor
from valor_common.model import Model
from valor_common.robot import RobotDescription


@dataclass
class Errors:
    """Estimate against truth over time, both seen from where the robot stood at the beginning."""

    position: list[FloatArray] = field(default_factory=list)
    velocity: list[FloatArray] = field(default_factory=list)
    tilt: list[float] = field(default_factory=list)

    def note(self, state: RobotState, base: FloatArray, velocity: FloatArray) -> None:
        turn = np.zeros((3, 3))
        rotation.matrix(rotation.quaternion(base[3:7]), turn)
        self.position.append(state.pelvis_position_in_odom - base[:3])
        self.velocity.append(state.pelvis_linear_velocity_in_odom - velocity)
        self.tilt.append(float(np.arccos(min(1.0, state.pelvis_rotation_in_odom[2] @ turn[2]))))


def run(loop: ClosedLoop, seconds: float) -> Errors:
    """Go on and compare: the plant's state before the period is what the estimate is of."""
    errors = Errors()
    for _ in range(round(seconds / loop.robot.control_period)):
        base, velocity = loop.plant.data.qpos[:7].copy(), loop.plant.data.qvel[:3].copy()
        loop.step()
        errors.note(loop.state, base, velocity)
    return errors


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_pushed_on_noisy_hardware_it_follows_the_truth(robot: RobotDescription, seed: int) -> None:
    loop = ClosedLoop(robot, "hardware", seed)
    loop.settle(0.3)
    loop.run(0.7)
    loop.plant.push(np.array((12.0, 8.0, 0.0)), 0.1)
    errors = run(loop, 1.0)
    position = np.array(errors.position)
    moved = position - position[0]
    assert np.abs(moved).max() < 0.008  # [m], while the pelvis moves by 6 cm
    assert np.sqrt((np.array(errors.velocity) ** 2).mean(axis=0)).max() < 0.015  # [m/s]
    bias = robot.tables.actuators["hardware"].noise.orientation_bias
    assert max(errors.tilt) < 4.0 * bias + 0.003  # [rad]


def test_without_errors_of_devices_it_is_nearly_exact(robot: RobotDescription) -> None:
    loop = ClosedLoop(robot, "ideal")
    errors = run(loop, 0.6)
    position = np.array(errors.position)
    assert np.abs(position - position[0]).max() < 0.002
    assert np.abs(np.array(errors.velocity)[100:]).max() < 0.005
    assert max(errors.tilt) < 1e-3


def test_odom_lies_between_the_feet_facing_as_they_do(robot: RobotDescription) -> None:
    loop = ClosedLoop(robot, "ideal")
    loop.plant.data.qpos[:2] = (3.0, -7.0)
    loop.plant.data.qpos[3:7] = rotation.about_z(2.0)
    loop.step()
    state = loop.state
    np.testing.assert_allclose(state.sole_positions_in_odom.mean(axis=0), 0.0, atol=1e-3)
    assert rotation.mean_yaw(*state.sole_rotations_in_odom) == pytest.approx(0.0, abs=1e-6)
    assert state.sole_positions_in_odom[0, 1] > 0.05  # the left foot is on the left
    assert state.pelvis_position_in_odom[2] == pytest.approx(robot.tables.nominal_base_height, abs=2e-3)


def test_forces_contacts_and_centre_of_pressure(robot: RobotDescription) -> None:
    loop = ClosedLoop(robot, "ideal")
    loop.run(1.0)
    state = loop.state
    weight = loop.estimator.dynamics.mass * 9.81
    assert state.contacts.tolist() == [1, 1]
    assert state.foot_forces.sum() == pytest.approx(weight, rel=0.02)
    np.testing.assert_allclose(state.cop_in_odom, state.com_in_odom[:2], atol=0.005)
    np.testing.assert_allclose(state.dcm_in_odom, state.com_in_odom, atol=0.005)


def with_forces(proprioceptor: Proprioceptor, left: float, right: float, time: int) -> Proprioceptor:
    """The same, later, its feet loaded otherwise [N]."""
    return msgspec.structs.replace(
        proprioceptor,
        time=time,
        left_foot_wrench=np.array((0.0, 0.0, left, 0.0, 0.0, 0.0)),
        right_foot_wrench=np.array((0.0, 0.0, right, 0.0, 0.0, 0.0)),
    )


@pytest.fixture
def measured(robot: RobotDescription) -> Proprioceptor:
    """What the devices report of ESCHER, standing."""
    loop = ClosedLoop(robot, "ideal")
    loop.run(0.1)
    return loop.sensors.measure(1, 0)


def test_contact_has_hysteresis(robot: RobotDescription, model: Model, measured: Proprioceptor) -> None:
    estimator = FloatingBaseEstimator(robot, model)
    weight = Dynamics(model).mass * 9.81
    table = robot.tables.estimator
    between = 0.5 * (table.contact_on + table.contact_off) * weight
    contacts = []
    for k, left in enumerate(
        (between, 2.0 * table.contact_on * weight, between, 0.5 * table.contact_off * weight, between)
    ):
        state = estimator.update(with_forces(measured, left, weight, k * 2_000_000))
        contacts.append(int(state.contacts[0]))
        assert state.contacts[1] == 1
    assert contacts == [0, 1, 1, 0, 0]


def test_without_contact_it_stays_finite_and_slow(
    robot: RobotDescription, model: Model, measured: Proprioceptor
) -> None:
    """Hung up: nothing tells the velocity, and the accelerometer's error must not run away."""
    estimator = FloatingBaseEstimator(robot, model)
    biased = msgspec.structs.replace(measured, imu_linear_acceleration=np.array((0.1, 0.0, 9.81)))
    state = None
    for k in range(2500):
        state = estimator.update(with_forces(biased, 0.0, 0.0, k * 2_000_000))
    assert state is not None
    assert state.contacts.tolist() == [0, 0]
    assert np.isnan(state.cop_in_odom).all()
    assert np.linalg.norm(state.pelvis_linear_velocity_in_odom) < 0.1
    landed = estimator.update(with_forces(biased, 400.0, 400.0, 2501 * 2_000_000))
    assert landed.contacts.tolist() == [1, 1]
    jump = landed.pelvis_position_in_odom - state.pelvis_position_in_odom
    assert np.abs(jump).max() < 0.002


def test_a_foot_that_slips_wears_off(robot: RobotDescription, model: Model, measured: Proprioceptor) -> None:
    """The left foot has moved outwards by the hip's roll, both loaded: the estimate goes halfway, then stays finite."""
    estimator = FloatingBaseEstimator(robot, model)
    before = estimator.update(with_forces(measured, 370.0, 370.0, 0))
    slipped = measured.joint_position.copy()
    slipped[robot.index["l_hip_roll"]] += 0.03
    moved = msgspec.structs.replace(measured, joint_position=slipped)
    state = before
    for k in range(1, 10000):
        state = estimator.update(with_forces(moved, 370.0, 370.0, k * 2_000_000))
    apart = state.sole_positions_in_odom[0] - state.sole_positions_in_odom[1]
    assert apart[1] > 0.22
    assert np.abs(state.pelvis_position_in_odom - before.pelvis_position_in_odom).max() < 0.03
    assert np.abs(state.pelvis_linear_velocity_in_odom).max() < 0.01


def test_heading_drift_of_the_imu_is_held_by_the_feet(
    robot: RobotDescription, model: Model, measured: Proprioceptor
) -> None:
    estimator = FloatingBaseEstimator(robot, model)
    rate = 0.01  # [rad/s]
    start = rotation.quaternion(measured.imu_orientation)
    state = None
    for k in range(5000):
        drifted = np.array(rotation.multiply(rotation.about_z(rate * k * 0.002), start))
        state = estimator.update(
            with_forces(msgspec.structs.replace(measured, imu_orientation=drifted), 370.0, 370.0, k * 2_000_000)
        )
    assert state is not None
    drift = rotation.mean_yaw(*state.sole_rotations_in_odom)
    assert abs(drift) < 0.2 * rate * 10.0
    assert abs(drift) < 2.0 * rate * robot.tables.estimator.heading_time_constant


def test_attitude_filter_takes_the_gyroscopes_motion_and_the_imus_level() -> None:
    rng = np.random.default_rng(5)
    attitude = Attitude(0.02, rotation.IDENTITY)
    attitude.reset(rotation.IDENTITY)
    truth, dt, deviations = rotation.IDENTITY, 0.002, []
    for k in range(3000):
        rate = np.array((0.5 * np.sin(0.01 * k), 0.3 * np.cos(0.02 * k), 0.1))
        truth = rotation.quaternion(rotation.multiply(truth, rotation.small(*(rate * dt).tolist())))
        noisy = rotation.multiply(truth, rotation.small(*rng.normal(scale=0.002, size=3).tolist()))
        attitude.update(noisy, rate + rng.normal(scale=0.005, size=3), dt)
        w, *_ = rotation.multiply(rotation.conjugate(truth), attitude.orientation)
        deviations.append(2.0 * np.arccos(min(1.0, abs(w))))
    assert np.sqrt(np.mean(np.square(deviations))) < 0.0007  # of 0.0035 that the IMU's own has
