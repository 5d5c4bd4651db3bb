"""The simulated robot: errors from one seed, forces that add up, pushes that push."""

import mujoco
import numpy as np
import pytest

from harness.motion_states import motor
from harness.places import ROBOTS
from valor.common.errors import ConfigurationError
from valor.common.messages import JointMode, Proprioceptor
from valor.devices.kvh import BIASES, DENSITIES
from valor.robot.description import RobotDescription
from valor.robot.model import full_model
from valor.robot.tables import SensorNoise
from valor.simulation.plant import Plant, SimulationDivergedError, scene
from valor.simulation.sensors import Sensors

ROBOT = RobotDescription.load(ROBOTS / "escher")
N = len(ROBOT.joints)
NOMINAL = full_model(ROBOT)
GRAVITY = 9.81


def plant(profile: str = "ideal", seed: int = 0) -> Plant:
    return Plant(ROBOT, "flat", profile, seed)


def sensors(of: Plant, profile: str = "ideal", seed: int = 0) -> Sensors:
    return Sensors(ROBOT, of, ROBOT.tables.actuators[profile].noise, seed)


def stand(robot: Plant) -> None:
    robot.actuators.obey(motor(ROBOT))


def run(profile: str, seed: int, periods: int, look: bool = False) -> list[Proprioceptor]:
    robot = plant(profile, seed)
    devices = sensors(robot, profile, seed)
    stand(robot)
    measured = []
    for k in range(periods):
        robot.step(2)
        measured.append(devices.measure(k, k))
        if look:
            mujoco.mj_kinematics(robot.model.mj, robot.data)
            mujoco.mj_comPos(robot.model.mj, robot.data)
    return measured


def test_one_seed_repeats_bit_for_bit_and_another_does_not() -> None:
    first, again, other = run("hardware", 3, 200), run("hardware", 3, 200), run("hardware", 4, 200)
    assert first == again == run("hardware", 3, 200, look=True), "also if the truth is read meanwhile"
    assert first != other


def test_the_hardware_plant_differs_from_the_controllers_model_by_at_most_what_the_profile_states() -> None:
    mj = plant("hardware").model.mj
    profile = ROBOT.tables.actuators["hardware"]
    ratios = [mj.body(NOMINAL.mj.body(i).name).mass[0] / NOMINAL.mj.body_mass[i] for i in range(1, NOMINAL.mj.nbody)]
    assert max(ratios) <= 1 + profile.mass_error and min(ratios) >= 1 - profile.mass_error
    assert np.std(ratios) > 0.3 * profile.mass_error
    robot = plant("hardware")
    friction = robot.model.mj.dof_frictionloss[robot.model.dof]
    expected = np.minimum(profile.friction, profile.friction_share * ROBOT.effort_limit)
    np.testing.assert_array_equal(friction, expected)
    assert friction[ROBOT.index["l_knee_pitch"]] == profile.friction and friction[ROBOT.index["l_thumb_roll"]] < 0.1


def test_the_hdt_arms_sag_and_the_sick_wrist_stays() -> None:
    wrist, elbow = ROBOT.index["r_wrist_yaw"], ROBOT.index["r_elbow_pitch"]
    robot = plant("drc_finals")
    servo = {"stiffness": ROBOT.servo_stiffness, "damping": ROBOT.servo_damping}
    target = ROBOT.nominal_posture.copy()
    target[wrist] += 0.5
    weight = np.zeros(N)  # what would carry the arm, and is not taken
    weight[ROBOT.group_indices("right_arm")] = robot.data.qfrc_bias[robot.model.dof][ROBOT.group_indices("right_arm")]
    robot.actuators.obey(motor(ROBOT, JointMode.IMPEDANCE, position=target, effort=weight, **servo))
    robot.step(1500)
    moved = robot.joint_position - ROBOT.nominal_posture
    assert abs(moved[wrist]) < 0.02
    assert 0.02 < abs(moved[elbow]) < 0.06  # half the backlash, and what the servo gives way to the forearm's weight


def test_the_ideal_plant_is_the_controllers_model() -> None:
    mj = plant("ideal").model.mj
    for i in range(1, NOMINAL.mj.nbody):
        assert mj.body(NOMINAL.mj.body(i).name).mass[0] == NOMINAL.mj.body_mass[i]
    assert not mj.dof_frictionloss.any() and mj.opt.timestep == ROBOT.tables.physics_step
    assert mj.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST


@pytest.mark.parametrize("profile", ["ideal", "hardware"])
def test_standing_feet_carry_the_weight_and_the_imu_feels_gravity(profile: str) -> None:
    measured = run(profile, 0, 1500)[-200:]
    robot = plant(profile)
    weight = robot.model.mj.body_mass.sum() * GRAVITY
    left = np.mean([m.left_foot_wrench for m in measured], axis=0)
    right = np.mean([m.right_foot_wrench for m in measured], axis=0)
    np.testing.assert_allclose((left + right)[:3], (0, 0, weight), atol=0.005 * weight)
    # The CoP of each foot is inside its sole.
    for wrench, foot in ((left, ROBOT.tables.feet.left), (right, ROBOT.tables.feet.right)):
        x, y = -wrench[4] / wrench[2], wrench[3] / wrench[2]
        assert foot.heel < x < foot.toe and abs(y) < foot.half_width
    hands = np.mean([np.concatenate((m.left_hand_wrench, m.right_hand_wrench)) for m in measured], axis=0)
    np.testing.assert_allclose(hands, 0, atol=1.0)
    gravity = np.mean([m.imu_linear_acceleration for m in measured], axis=0)
    assert np.linalg.norm(gravity) == pytest.approx(GRAVITY, rel=0.01) and gravity[2] > 0.99 * np.linalg.norm(gravity)


def test_foot_wrenches_balance_the_robots_momentum() -> None:
    """Newton: through a stumble after a push, feet's forces + weight + push = rate of change of linear momentum."""
    robot = plant("ideal")
    devices = sensors(robot)
    stand(robot)
    robot.step(1000)
    data, mass = robot.data, robot.model.mj.body_mass.sum()
    robot.push(np.array([0.0, 20.0, 0.0]), 0.1)
    force = 200.0
    for _ in range(100):
        com_before = momentum(robot)
        robot.step(1)
        acceleration = (momentum(robot) - com_before) / robot.step_time
        m = devices.measure(1, 1)
        measured = np.zeros(3)
        for wrench, sole in ((m.left_foot_wrench, "l_sole"), (m.right_foot_wrench, "r_sole")):
            measured += data.site(sole).xmat.reshape(3, 3) @ wrench[:3]
        expected = acceleration - (0.0, force, -mass * GRAVITY)
        np.testing.assert_allclose(measured, expected, atol=0.01 * mass * GRAVITY)
    assert not robot.pushed


def momentum(robot: Plant) -> np.ndarray:
    """(3,) linear momentum in world [kg·m/s]."""
    mj, data = robot.model.mj, robot.data
    scratch = mujoco.MjData(mj)
    scratch.qpos[:], scratch.qvel[:] = data.qpos, data.qvel
    mujoco.mj_fwdPosition(mj, scratch)
    mujoco.mj_fwdVelocity(mj, scratch)
    mujoco.mj_subtreeVel(mj, scratch)
    momentum: np.ndarray = mj.body_mass.sum() * scratch.subtree_linvel[robot.model.body("pelvis")]
    return momentum


def test_noise_has_the_deviation_of_its_table() -> None:
    robot = plant("ideal")
    noise = SensorNoise(joint_position=2e-4, joint_velocity=0.02, joint_effort=0.5, gyroscope=0.005,
                        orientation=0.002, accelerometer=0.05, force=2.0, torque=0.2)  # fmt: skip
    devices = Sensors(ROBOT, robot, noise, seed=1)
    samples = [devices.measure(k, k) for k in range(600)]

    def deviation(read: str) -> float:
        return float(np.std([getattr(sample, read) for sample in samples], axis=0).mean())

    assert deviation("joint_position") == pytest.approx(noise.joint_position, rel=0.05)
    assert deviation("joint_velocity") == pytest.approx(noise.joint_velocity, rel=0.05)
    assert deviation("joint_effort") == pytest.approx(noise.joint_effort, rel=0.05)
    assert deviation("imu_angular_velocity") == pytest.approx(noise.gyroscope, rel=0.1)
    assert deviation("imu_linear_acceleration") == pytest.approx(noise.accelerometer, rel=0.1)
    wrench = np.std([sample.left_hand_wrench for sample in samples], axis=0)
    assert wrench[:3].mean() == pytest.approx(noise.force, rel=0.1)
    assert wrench[3:].mean() == pytest.approx(noise.torque, rel=0.1)
    orientations = np.array([sample.imu_orientation for sample in samples])
    np.testing.assert_allclose(np.linalg.norm(orientations, axis=1), 1.0)
    assert 2 * orientations[:, 1:].std(axis=0).mean() == pytest.approx(noise.orientation, rel=0.1)


def test_the_second_imu_has_the_noise_of_its_makers_data_and_its_own_place() -> None:
    """Turned about the pelvis' z, it is drawn outwards 0.04 m behind the first; its noise leaves the others' alone."""
    robot = plant("ideal")
    robot.data.qvel[5] = 2.0
    mujoco.mj_forward(robot.model.mj, robot.data)
    ideal = sensors(robot).measure(1, 1)
    np.testing.assert_allclose(ideal.kvh_angular_velocity, (0.0, 0.0, 2.0), atol=1e-12)
    drawn = (ideal.kvh_linear_acceleration - ideal.imu_linear_acceleration)[0]
    assert drawn == pytest.approx(0.04 * 2.0**2, rel=1e-6)
    devices = sensors(robot, "hardware", seed=1)
    samples = [devices.measure(k, k) for k in range(600)]
    for read, density, bias in zip(("kvh_angular_velocity", "kvh_linear_acceleration"), DENSITIES, BIASES, strict=True):
        values = np.array([getattr(sample, read) - getattr(ideal, read) for sample in samples])
        expected = density * ROBOT.tables.control_rate**0.5
        assert values.std(axis=0).mean() == pytest.approx(expected, rel=0.1)
        assert 0.0 < np.abs(values.mean(axis=0)).max() < 4.0 * (bias + expected / len(samples) ** 0.5)


def test_encoders_have_a_resolution_and_the_imu_a_bias() -> None:
    robot = plant("ideal")
    devices = Sensors(ROBOT, robot, SensorNoise(joint_position_resolution=0.01, orientation_bias=0.05), seed=1)
    measured = devices.measure(1, 1)
    ticks = measured.joint_position / 0.01
    np.testing.assert_allclose(ticks, np.rint(ticks), atol=1e-9)
    assert np.abs(measured.joint_position - ROBOT.nominal_posture).max() <= 0.005 + 1e-9
    first, second = measured.imu_orientation, devices.measure(2, 2).imu_orientation
    np.testing.assert_array_equal(first, second)
    tilt = 2 * first[1:]
    assert 0 < np.linalg.norm(tilt[:2]) < 0.25 and abs(tilt[2]) < 0.01


def test_divergence_is_an_error_not_a_reset() -> None:
    robot = plant("ideal")
    robot.data.qvel[10] = np.nan
    with pytest.raises(SimulationDivergedError, match=r"diverged at 0\.00"):
        robot.step(2)


def test_unknown_worlds_and_profiles_are_rejected_by_name() -> None:
    with pytest.raises(ConfigurationError, match="world 'moon': expected one of flat"):
        scene(ROBOT, "moon", 0, "collision")
    with pytest.raises(ConfigurationError, match=r"actuators 'perfect'.*ideal, hardware"):
        Plant(ROBOT, "flat", "perfect", 0)
