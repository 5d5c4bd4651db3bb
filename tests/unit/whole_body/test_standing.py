"""Standing, reaching, being pushed: the controller on a plant that is not its model, in one process.

Only what the tests measure looks at the simulator's truth; the controller sees Proprioceptor alone.
"""

import numpy as np
import pytest

from harness.closed_loop import ClosedLoop, load_robot
from valor.common.arrays import FloatArray
from valor.common.table import checked, plain
from valor.robot.description import RobotDescription
from valor.robot.tables import RobotTables
from valor.whole_body.balance.reference import minimum_jerk
from valor.whole_body.command import QpStatus

pytestmark = pytest.mark.portable

DIRECTIONS = {"forward": (1.0, 0.0, 0.0), "back": (-1.0, 0.0, 0.0), "left": (0.0, 1.0, 0.0), "right": (0.0, -1.0, 0.0)}


def pelvis(loop: ClosedLoop) -> FloatArray:
    """(3,) where the pelvis truly is [m]."""
    position: FloatArray = loop.plant.data.qpos[:3].copy()
    return position


def with_effort_limit(robot: RobotDescription, joints: list[str], limit: float) -> RobotDescription:
    """The robot with weaker joints [N·m]."""
    content = plain(robot.tables)
    for joint in joints:
        content["joints"][joint]["effort"] = limit
    return RobotDescription(robot.folder, checked(RobotTables, content))


def feet(loop: ClosedLoop) -> FloatArray:
    """(2, 3) where the soles truly are [m]."""
    tables = loop.robot.tables
    sites = [loop.plant.model.site(foot.sole) for foot in (tables.feet.left, tables.feet.right)]
    positions: FloatArray = loop.plant.data.site_xpos[sites].copy()
    return positions


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_stands_quietly_on_hardware(robot: RobotDescription, seed: int) -> None:
    loop = ClosedLoop(robot, "hardware", seed)
    loop.settle(0.3)
    placed = feet(loop)
    loop.run(3.0)
    heights, efforts, errors, desired, felt = [], [], [], [], []

    def note(loop: ClosedLoop) -> None:
        heights.append(pelvis(loop)[2])
        efforts.append(loop.command.effort)
        errors.append(loop.state.dcm_in_odom - loop.command.dcm_reference_in_odom)
        desired.append(loop.command.desired_foot_forces)
        felt.append(loop.state.foot_forces)

    loop.run(1.5, note)
    assert loop.fall is None and loop.command.qp_status is QpStatus.OPTIMAL and loop.command.qp_failures == 0
    assert np.ptp(heights) < 0.003 and abs(np.mean(heights) - robot.tables.nominal_base_height) < 0.01
    assert np.sqrt((np.array(errors) ** 2).mean(axis=0)).max() < 0.004
    assert np.abs(feet(loop) - placed).max() < 0.003
    # Noise must not shake the motors: changes from one period to the next are small against what they can do.
    chatter = np.diff(efforts, axis=0).std(axis=0)
    assert (chatter < 0.02 * robot.effort_limit).all()
    # What the QP plans for the feet is what they feel, but for the masses' error.
    np.testing.assert_allclose(np.mean(desired, axis=0), np.mean(felt, axis=0), rtol=0.06)


def test_begins_without_a_jump_and_ends_at_nominal(robot: RobotDescription) -> None:
    """From a lower posture with one arm raised: references start where the robot is."""
    posture = robot.nominal_posture.copy()
    for side in ("l", "r"):
        for joint, change in (("hip_pitch", -0.1), ("knee_pitch", 0.2), ("ankle_pitch", -0.1)):
            posture[robot.index[f"{side}_{joint}"]] += change
    for joint, angle in robot.tables.arm_presets["forward"]["right"].items():
        posture[robot.index[joint]] = angle
    loop = ClosedLoop(robot, "ideal")
    loop.settle(2.0, posture)
    low = pelvis(loop)[2]
    held = loop.plant.actuators.effort.copy()
    loop.reference.position = posture.copy()
    loop.step()
    np.testing.assert_allclose(loop.command.dcm_reference_in_odom, loop.state.com_in_odom, atol=1e-3)
    legs = robot.group_indices("left_leg")
    assert np.abs(loop.command.effort - held)[legs].max() < 0.15 * robot.effort_limit[legs].max()
    arm = robot.group_indices("right_arm")
    np.testing.assert_allclose(loop.command.position[arm], loop.state.joint_position[arm], atol=1e-3)
    speeds = []
    loop.run(3.5, lambda loop: speeds.append(np.abs(loop.plant.data.qvel).max()))
    assert loop.fall is None
    assert max(speeds) < 0.6  # [m/s, rad/s]
    assert low < robot.tables.nominal_base_height - 0.01
    assert pelvis(loop)[2] == pytest.approx(robot.tables.nominal_base_height, abs=0.003)


def reach(loop: ClosedLoop, duration: float) -> None:
    """Move the right arm from nominal to the preset ``forward``."""
    start, goal, began = loop.reference.position.copy(), loop.reference.position.copy(), loop.time
    for joint, angle in loop.robot.tables.arm_presets["forward"]["right"].items():
        goal[loop.robot.index[joint]] = angle

    def follow(loop: ClosedLoop) -> None:
        s, rate, acceleration = minimum_jerk(loop.time - began, duration)
        loop.reference.position = start + s * (goal - start)
        loop.reference.velocity = rate * (goal - start)
        loop.reference.acceleration = acceleration * (goal - start)

    loop.run(duration + 1.0, follow)


def test_an_arm_moves_and_the_torso_stays(robot: RobotDescription) -> None:
    loop = ClosedLoop(robot, "hardware", 0)
    loop.settle(0.3)
    loop.run(3.0)
    before = pelvis(loop)
    reach(loop, 1.5)
    arm = robot.group_indices("right_arm")
    assert np.abs(loop.plant.joint_position - loop.reference.position)[arm].max() < 0.02
    assert np.abs(loop.command.position - loop.reference.position)[arm].max() < 0.005
    assert np.linalg.norm(pelvis(loop) - before) < 0.005


def test_without_the_coms_shift_the_torso_moves_back() -> None:
    """The thesis' behaviour (5.3): the CoM stays, and the torso gives way to the arm."""
    loop = ClosedLoop(load_robot(whole_body={"com_shift_limit": 0.0}))
    loop.run(2.2)
    before = pelvis(loop)
    reach(loop, 1.5)
    back, _, down = pelvis(loop) - before
    assert back < -0.025
    assert down < -0.002


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_a_push_of_15_newton_seconds_is_survived(robot: RobotDescription, direction: str) -> None:
    loop = ClosedLoop(robot, "hardware", 3)
    loop.settle(0.3)
    loop.run(2.1)
    placed = feet(loop)
    loop.plant.push(15.0 * np.array(DIRECTIONS[direction]), 0.1)
    loop.run(2.5)
    assert loop.fall is None and loop.command.qp_failures == 0 and np.abs(feet(loop) - placed).max() < 0.01
    assert np.linalg.norm((loop.state.dcm_in_odom - loop.command.dcm_reference_in_odom)[:2]) < 0.01


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_a_push_of_80_newton_seconds_is_reported_to_be_a_fall_before_the_robot_tilts(direction: str) -> None:
    """Of a robot that may not step: nothing can save it."""
    robot = load_robot(disturbance={"step_when_standing": False})
    loop = ClosedLoop(robot, "hardware", 4)
    loop.settle(0.3)
    loop.run(0.5)
    began = loop.time
    loop.plant.push(80.0 * np.array(DIRECTIONS[direction]), 0.1)
    while loop.fall is None and loop.time < began + 0.5:
        loop.step()
    assert loop.fall is not None and loop.fall.startswith("DCM") and loop.time - began < 0.15
    assert loop.state.pelvis_rotation_in_odom[2, 2] > np.cos(0.3)
    loop.run(1.0)
    assert pelvis(loop)[2] < 0.7 * robot.tables.nominal_base_height  # it fell indeed
    assert np.isfinite(loop.command.effort).all()


def test_torque_limits_bind_and_the_robot_still_stands(robot: RobotDescription) -> None:
    """Ankles too weak for what a push asks of them: the QP finds the best within the limits."""
    ankles, limit = ["l_ankle_pitch", "r_ankle_pitch"], 35.0
    free, weak = ClosedLoop(robot, "ideal"), ClosedLoop(with_effort_limit(robot, ankles, limit), "ideal")
    places = [robot.index[ankle] for ankle in ankles]
    torques: dict[ClosedLoop, float] = {free: 0.0, weak: 0.0}
    statuses: dict[ClosedLoop, set[int]] = {free: set(), weak: set()}

    def note(loop: ClosedLoop) -> None:
        torques[loop] = max(torques[loop], float(np.abs(loop.command.effort[places]).max()))
        statuses[loop].add(loop.command.qp_status)

    for loop in (free, weak):
        loop.run(0.5)
        loop.plant.push(np.array((10.0, 0.0, 0.0)), 0.1)
        loop.run(1.0, note)
        assert loop.fall is None and QpStatus.INFEASIBLE not in statuses[loop]
    assert torques[free] > 1.1 * limit and torques[weak] <= limit + 1e-5 and QpStatus.LIMITED in statuses[weak]


def test_without_a_solution_the_last_torques_go_on_with_damping(robot: RobotDescription) -> None:
    loop = ClosedLoop(robot, "ideal")
    loop.run(0.3)
    last, held = loop.command, loop.command.position.copy()
    loop.state.kinematics.mass_matrix[7, 7] = np.nan
    failed = loop.controller.update(loop.state, loop.request, robot.control_period)
    assert failed.qp_status is QpStatus.INFEASIBLE and failed.qp_failures == 1
    places = loop.estimator.kinematics.joints.places
    damped = (last.effort - robot.servo_damping * loop.state.joint_velocity)[places]
    np.testing.assert_allclose(failed.effort[places], damped, atol=1e-9)
    assert not failed.acceleration.any()
    arm = robot.group_indices("right_arm")
    np.testing.assert_allclose(failed.position[arm], held[arm])
    assert not failed.velocity.any()
    loop.run(0.5)  # the next state is sound again
    assert loop.command.qp_status is QpStatus.OPTIMAL and loop.command.qp_failures == 1 and loop.fall is None


def test_the_same_seed_gives_the_same_run_bit_for_bit(robot: RobotDescription) -> None:
    ends = []
    for _ in range(2):
        loop = ClosedLoop(robot, "hardware", 5)
        loop.run(0.4)
        ends.append(np.concatenate((loop.plant.data.qpos, loop.command.effort)))
    np.testing.assert_array_equal(ends[0], ends[1])
