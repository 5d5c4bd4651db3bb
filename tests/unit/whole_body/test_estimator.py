"""The estimator against the simulator's truth, which only the test may look at."""

import msgspec
import numpy as np
import pytest

from harness.closed_loop import ClosedLoop
from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.common.messages import Proprioceptor
from valor.control.estimation.estimator import FloatingBaseEstimator
from valor.control.estimation.filters import LARGEST_LEVEL, Attitude
from valor.control.kinematics import Kinematics
from valor.control.state import RobotState
from valor.control.tuning_tables import Tuning
from valor.robot.description import RobotDescription
from valor.robot.model import Model, controller_model
from valor.whole_body.walking.velocity_steps import VelocitySteps


def tilt(state: RobotState, base: FloatArray) -> float:
    """Between the pelvis as it is believed and as it is [rad]."""
    turn = np.zeros((3, 3))
    rotation.matrix(rotation.quaternion(base[3:7]), turn)
    return float(np.arccos(min(1.0, state.pelvis_rotation_in_odom[2] @ turn[2])))


def run(loop: ClosedLoop, seconds: float) -> tuple[FloatArray, FloatArray, list[float]]:
    """Go on; errors of position, velocity and tilt: the plant's state before the period is what the estimate is of."""
    position, velocity, tilts = [], [], []
    for _ in range(round(seconds / loop.robot.control_period)):
        base, speed = loop.plant.data.qpos[:7].copy(), loop.plant.data.qvel[:3].copy()
        loop.step()
        position.append(loop.state.pelvis_position_in_odom - base[:3])
        velocity.append(loop.state.pelvis_linear_velocity_in_odom - speed)
        tilts.append(tilt(loop.state, base))
    return np.array(position), np.array(velocity), tilts


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_pushed_on_noisy_hardware_it_follows_the_truth(robot: RobotDescription, seed: int) -> None:
    loop = ClosedLoop(robot, "hardware", seed)
    loop.settle(0.3)
    loop.run(0.7)
    loop.plant.push(np.array((12.0, 8.0, 0.0)), 0.1)
    position, velocity, tilts = run(loop, 1.0)
    assert np.abs(position - position[0]).max() < 0.008  # [m], while the pelvis moves by 6 cm
    assert np.sqrt((velocity**2).mean(axis=0)).max() < 0.015  # [m/s]
    bias = robot.tables.actuators["hardware"].noise.orientation_bias
    assert max(tilts) < 4.0 * bias + 0.003  # [rad]


def test_without_errors_of_devices_it_is_nearly_exact(robot: RobotDescription) -> None:
    loop = ClosedLoop(robot, "ideal")
    position, velocity, tilts = run(loop, 0.6)
    assert np.abs(position - position[0]).max() < 0.002
    assert np.abs(velocity[100:]).max() < 0.005
    assert max(tilts) < 1e-3


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
    weight = loop.estimator.kinematics.mass * 9.81
    assert state.contacts.tolist() == [1, 1] and state.foot_forces.sum() == pytest.approx(weight, rel=0.02)
    np.testing.assert_allclose(state.cop_in_odom, state.com_in_odom[:2], atol=0.005)
    np.testing.assert_allclose(state.dcm_in_odom, state.com_in_odom, atol=0.005)


def with_forces(proprioceptor: Proprioceptor, left: float, right: float, time: int) -> Proprioceptor:
    """The same, later, its feet loaded otherwise [N]."""
    return msgspec.structs.replace(
        proprioceptor, time=time, left_foot_wrench=np.array((0.0, 0.0, left, 0.0, 0.0, 0.0)),
        right_foot_wrench=np.array((0.0, 0.0, right, 0.0, 0.0, 0.0)),
    )  # fmt: skip


@pytest.fixture
def measured(robot: RobotDescription) -> Proprioceptor:
    """What the devices report of ESCHER, standing."""
    loop = ClosedLoop(robot, "ideal")
    loop.run(0.1)
    return loop.sensors.measure(1, 0)


def test_contact_has_hysteresis(robot: RobotDescription, model: Model, measured: Proprioceptor) -> None:
    estimator = FloatingBaseEstimator(robot, model)
    weight = Kinematics(model).mass * 9.81
    table = robot.read(Tuning).estimator
    between = 0.5 * (table.contact_on + table.contact_off) * weight
    contacts = []
    for k, left in enumerate(
        (between, 2.0 * table.contact_on * weight, between, 0.5 * table.contact_off * weight, between)
    ):
        state = estimator.update(with_forces(measured, left, weight, k * 2_000_000))
        contacts.append(int(state.contacts[0]))
        assert state.contacts[1] == 1
    assert contacts == [0, 1, 1, 0, 0]


def test_the_covariance_stays_symmetric_and_positive(
    robot: RobotDescription, model: Model, measured: Proprioceptor
) -> None:
    """After each of 4000 periods of irregular length, in which feet land and leave."""
    estimator, rng, time = FloatingBaseEstimator(robot, model), np.random.default_rng(0), 0
    weight = Kinematics(model).mass * 9.81
    for k in range(4000):
        time += int(rng.integers(1, 8)) * 1_000_000
        left, right = ((0.5, 0.5), (1.0, 0.0), (0.5, 0.5), (0.0, 1.0), (0.0, 0.0))[k // 150 % 5]
        estimator.update(with_forces(measured, left * weight, right * weight, time))
        covariance = estimator._after.covariance
        np.testing.assert_allclose(covariance, covariance.T, rtol=1e-9, atol=1e-15)
        assert k < 10 or np.linalg.eigvalsh(covariance).min() > 0.0  # the position is exact at first, by definition


def test_without_contact_it_stays_finite_and_slow(
    robot: RobotDescription, model: Model, measured: Proprioceptor
) -> None:
    """Hung up: nothing reports the velocity, and the accelerometer's error must not run away."""
    estimator = FloatingBaseEstimator(robot, model)
    biased = msgspec.structs.replace(measured, imu_linear_acceleration=np.array((0.1, 0.0, 9.81)))
    state = None
    for k in range(2500):
        state = estimator.update(with_forces(biased, 0.0, 0.0, k * 2_000_000))
    assert state is not None and state.contacts.tolist() == [0, 0] and np.isnan(state.cop_in_odom).all()
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


def test_the_imus_heading_is_held_by_the_feet(robot: RobotDescription, model: Model, measured: Proprioceptor) -> None:
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
    assert abs(drift) < 2.0 * rate * robot.read(Tuning).estimator.heading_time_constant


def test_attitude_filter_takes_the_gyroscopes_motion_and_the_imus_level() -> None:
    rng = np.random.default_rng(5)
    attitude = Attitude(rotation.IDENTITY, rate=(0.0, 0.0, 0.1))
    truth, dt, deviations = rotation.IDENTITY, 0.002, []
    for k in range(3000):
        rate = np.array((0.5 * np.sin(0.01 * k), 0.3 * np.cos(0.02 * k), 0.1))
        truth = rotation.quaternion(rotation.multiply(truth, rotation.small(*(rate * dt).tolist())))
        noisy = rotation.multiply(truth, rotation.small(*rng.normal(scale=0.002, size=3).tolist()))
        x, y, z = (rate + rng.normal(scale=0.005, size=3)).tolist()
        attitude = attitude.updated(noisy, (x, y, z), dt, 0.1, rotation.IDENTITY)
        w, *_ = rotation.multiply(rotation.conjugate(truth), attitude.orientation)
        deviations.append(2.0 * np.arccos(min(1.0, abs(float(w)))))
    assert np.sqrt(np.mean(np.square(deviations))) < 0.0007  # of 0.0035 that the IMU's own has


def test_no_imu_is_believed_to_be_mounted_askew() -> None:
    attitude, taken = Attitude(rotation.IDENTITY), []
    for _ in range(100):
        attitude, turned = attitude.tilted((0.001, 0.0, 0.0))
        taken.append(bool(turned))
    assert taken == sorted(taken, reverse=True)  # until the limit, then no more
    w, x, *_ = attitude.orientation
    assert LARGEST_LEVEL - 0.0015 < 2.0 * np.arctan2(float(x), float(w)) <= LARGEST_LEVEL


def test_an_imu_off_level_is_found_by_gravity(robot: RobotDescription, model: Model, measured: Proprioceptor) -> None:
    """Standing still: the IMU's attitude is 5 mrad off, its accelerometer is not."""
    estimator = FloatingBaseEstimator(robot, model)
    off = rotation.small(0.004, -0.003, 0.0)
    wrong = np.array(rotation.multiply(rotation.quaternion(measured.imu_orientation), off))
    tilts = []
    for k in range(3000):
        noticed = msgspec.structs.replace(with_forces(measured, 370.0, 370.0, k * 2_000_000), imu_orientation=wrong)
        tilts.append(estimator.update(noticed).pelvis_rotation_in_odom[2].copy())
    truth = np.zeros((3, 3))
    rotation.matrix(rotation.quaternion(measured.imu_orientation), truth)
    assert np.linalg.norm(tilts[0] - truth[2]) == pytest.approx(0.005, rel=0.02)
    assert np.linalg.norm(tilts[-1] - truth[2]) < 0.0008


def test_real_time_between_proprioceptors_counts(robot: RobotDescription) -> None:
    """A third of the Proprioceptors lost, in gaps of up to 16 ms, during a push: hardly any worse for it."""
    loop = ClosedLoop(robot, "hardware", 3)
    loop.settle(0.3)
    loop.run(1.0)
    loop.plant.push(np.array((12.0, 8.0, 0.0)), 0.1)
    log: list[tuple[Proprioceptor, FloatArray]] = []
    measure = loop.sensors.measure

    def recorded(sequence: int, time: int) -> Proprioceptor:
        proprioceptor = measure(sequence, time)
        log.append((proprioceptor, loop.plant.data.qvel[:3].copy()))
        return proprioceptor

    loop.sensors.measure = recorded  # type: ignore[method-assign]
    loop.run(1.5)
    rng = np.random.default_rng(1)
    keep = rng.random(len(log)) > 0.25
    for k in rng.integers(100, len(log), 12):
        keep[k : k + rng.integers(3, 8)] = False
    keep[:100] = True
    assert keep.sum() < 0.78 * len(log)
    errors = []
    for kept in (np.ones(len(log), dtype=bool), keep):
        estimator = FloatingBaseEstimator(robot, controller_model(robot))
        error = [
            estimator.update(proprioceptor).pelvis_linear_velocity_in_odom - velocity
            for (proprioceptor, velocity), seen in zip(log, kept, strict=True)
            if seen
        ]
        errors.append(np.sqrt(np.mean(np.square(error[100:]), axis=0)).max())
    assert errors[1] < 1.5 * errors[0] + 0.002 and errors[1] < 0.015


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_walking_it_estimates_where_it_is_and_how_well(robot: RobotDescription, seed: int) -> None:
    """Seven steps at up to 0.4 m/s: odometry's error stays below 1 % of the way, within its reported deviation."""
    loop = ClosedLoop(robot, "hardware", seed)
    loop.settle(0.3)
    loop.run(2.0)
    source = loop.request.steps = VelocitySteps(robot.tables.walking)
    start, believed = loop.plant.data.qpos[:3].copy(), loop.state.pelvis_position_in_odom
    before = loop.state.pelvis_position_variance
    tilts = []
    while loop.time < 8.0:
        source.command(np.array((0.4, 0.0, 0.1)), loop.time)
        source.advance(loop.time)
        base = loop.plant.data.qpos[:7].copy()
        loop.step()
        tilts.append(tilt(loop.state, base))
    assert loop.fall is None
    way = base[:3] - start
    error = loop.state.pelvis_position_in_odom - believed - way
    assert np.linalg.norm(way) > 1.2 and np.linalg.norm(error) < 0.01 * np.linalg.norm(way)
    grown = loop.state.pelvis_position_variance
    assert (grown > before).all()
    assert (np.abs(error) < 4.0 * np.sqrt(grown) + 0.004).all()  # 4 mm: of the lever between pelvis and heading
    assert np.sqrt(np.mean(np.square(tilts))) < 0.002  # the IMU's own is 2 to 4 mrad off


def test_a_foot_that_rolls_over_its_heel_moves_nothing(
    robot: RobotDescription, model: Model, measured: Proprioceptor
) -> None:
    """The left foot turns about its heel by 10°, the right one flat: the pelvis and the heel stay."""
    estimator = FloatingBaseEstimator(robot, model)
    heel = robot.tables.feet.left.heel
    ankle = robot.index["l_ankle_pitch"]
    knee, hip = robot.index["l_knee_pitch"], robot.index["l_hip_pitch"]
    right = np.array((0.0, 0.0, 370.0, 0.0, 0.0, 0.0))
    left = np.array((0.0, 0.0, 370.0, 0.0, -heel * 370.0, 0.0))
    first = state = estimator.update(with_forces(measured, 370.0, 370.0, 0))
    for k in range(1, 100):
        state = estimator.update(
            msgspec.structs.replace(measured, time=k * 2_000_000, left_foot_wrench=left, right_foot_wrench=right)
        )
    start = place = state.sole_positions_in_odom[0] + state.sole_rotations_in_odom[0] @ (heel, 0.0, 0.0)
    posture, kinematics = measured.joint_position.copy(), Kinematics(model)
    places = kinematics.joints.places
    fixed = state.pelvis_position_in_odom
    for k in range(100, 600):
        # The leg that keeps the pelvis while the sole turns about its heel, toes up: Newton steps on three joints.
        angle = -np.radians(10.0) * (k - 100) / 500
        for _ in range(3):
            kinematics.update(
                rotation.quaternion(first.pelvis_orientation_in_odom), np.zeros(3), posture[places], np.zeros(27)
            )
            here = kinematics.sole_position[0] + kinematics.sole_rotation[0] @ (heel, 0.0, 0.0) + fixed
            pitch = -np.arcsin(kinematics.sole_rotation[0][2, 0])
            error = np.array((*(start - here)[[0, 2]], angle - pitch))
            rows = kinematics.sole_jacobian[:6, 6:]
            lever = kinematics.sole_rotation[0] @ (heel, 0.0, 0.0)
            linear = rows[:3] + np.cross(rows[3:].T, lever).T
            columns = [j - robot.index["l_hip_yaw"] for j in (hip, knee, ankle)]
            step = np.linalg.solve(np.vstack((linear[[0, 2]], rows[4]))[:, columns], error)
            posture[[hip, knee, ankle]] += step
        state = estimator.update(
            msgspec.structs.replace(
                measured, time=k * 2_000_000, joint_position=posture.copy(), left_foot_wrench=left,
                right_foot_wrench=right,
            )
        )  # fmt: skip
    place = state.sole_positions_in_odom[0] + state.sole_rotations_in_odom[0] @ (heel, 0.0, 0.0)
    assert state.sole_rotations_in_odom[0][2, 0] > 0.15  # it has turned
    assert np.linalg.norm(place - start) < 0.002
    assert np.linalg.norm(state.pelvis_position_in_odom - fixed) < 0.002  # the sole's origin has risen by 17 mm


def test_a_slipping_foot_is_not_believed(robot: RobotDescription, model: Model, measured: Proprioceptor) -> None:
    """The left foot slips aside by 8 cm within half a second, lightly loaded: the right one keeps the pelvis."""
    estimator = FloatingBaseEstimator(robot, model)
    state = estimator.update(with_forces(measured, 370.0, 370.0, 0))
    for k in range(1, 500):
        state = estimator.update(with_forces(measured, 140.0, 600.0, k * 2_000_000))
    before = state
    assert state.contact_probability.min() > 0.9
    least = 1.0
    for k in range(500, 750):
        posture, velocity = measured.joint_position.copy(), measured.joint_velocity.copy()
        posture[robot.index["l_hip_roll"]] += 0.1 * (k - 500) / 250
        velocity[robot.index["l_hip_roll"]] = 0.2
        moved = msgspec.structs.replace(measured, joint_position=posture, joint_velocity=velocity)
        state = estimator.update(with_forces(moved, 140.0, 600.0, k * 2_000_000))
        least = min(least, float(state.contact_probability[0]))
    moved_foot = state.sole_positions_in_odom[0] - before.sole_positions_in_odom[0]
    assert moved_foot[1] > 0.07
    assert least < 0.9
    assert np.linalg.norm(state.pelvis_position_in_odom - before.pelvis_position_in_odom) < 0.01
