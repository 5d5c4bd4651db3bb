"""Pushes that the feet alone cannot hold: the robot steps, stands again, or falls without fighting it.

In one process, profile ``hardware``; what it can stand is in ``benchmarks/control.py``, these are well within.
"""

import dataclasses

import mujoco
import numpy as np
import pytest

from harness.closed_loop import ClosedLoop, load_robot
from valor.common.behaviors import Behavior
from valor.control.motor_command import MotorCommand
from valor.control.tuning_tables import Tuning
from valor.robot.description import RobotDescription
from valor.robot.footsteps import LEFT, RIGHT
from valor.whole_body.balance.watch import BalanceWatch
from valor.whole_body.walking.velocity_steps import VelocitySteps

DIRECTIONS = {"forward": (1.0, 0.0, 0.0), "back": (-1.0, 0.0, 0.0), "right": (0.0, -1.0, 0.0)}
PERIOD = 2_000_000  # [ns]


def standing(robot: RobotDescription, seed: int) -> ClosedLoop:
    loop = ClosedLoop(robot, "hardware", seed)
    loop.settle(0.3)
    loop.run(0.5)
    return loop


def ground_contact(loop: ClosedLoop) -> bool:
    """Return whether anything but the feet lies on the ground, in truth."""
    mj, data = loop.plant.model.mj, loop.plant.data
    feet = {loop.plant.model.body(foot.body) for foot in (loop.robot.tables.feet.left, loop.robot.tables.feet.right)}
    for contact in data.contact[: data.ncon]:
        bodies = {int(mj.geom_bodyid[geom]) for geom in contact.geom}
        if 0 in bodies and not bodies & feet:
            return True
    return False


@pytest.mark.parametrize(("direction", "impulse"), [("forward", 50.0), ("back", 35.0), ("right", 30.0)])
def test_a_push_is_answered_by_steps_and_the_robot_stands_again(direction: str, impulse: float) -> None:
    robot = load_robot()
    loop = standing(robot, 5)
    loop.plant.push(impulse * np.array(DIRECTIONS[direction]), 0.1)
    stepped, knee = False, np.inf
    knees = [robot.index["l_knee_pitch"], robot.index["r_knee_pitch"]]
    until = loop.time + (3.0 if direction == "right" else 6.0)
    while loop.fall is None and loop.time < until and not (stepped and not loop.controller.recovering):
        loop.step()
        stepped |= loop.controller.recovering
        knee = min(knee, float(loop.plant.joint_position[knees].min()))
    assert loop.fall is None
    assert knee > 0.25  # [rad]
    assert stepped == (direction != "right")  # sideways the stance is wide enough
    assert loop.controller.at_rest and loop.command.qp_failures == 0
    apart = loop.state.sole_positions_in_odom[LEFT] - loop.state.sole_positions_in_odom[RIGHT]
    np.testing.assert_allclose(apart, (0.0, robot.tables.walking.step_width, 0.0), atol=0.03)


@pytest.mark.parametrize(("heading", "foot"), [(67.5, LEFT), (-90.0, RIGHT)])
def test_a_push_aside_is_answered_by_a_wide_step_of_the_foot_on_that_side(heading: float, foot: int) -> None:
    loop = standing(load_robot(), 0)
    impulse, angle = 0.8 * loop.robot.tables.size.mass, np.radians(heading)
    loop.plant.push(impulse * np.array((np.cos(angle), np.sin(angle), 0.0)), 0.1)
    first, until = None, loop.time + 6.0
    while loop.fall is None and loop.time < until and not (first is not None and not loop.controller.recovering):
        loop.step()
        first = loop.controller.swinging if first is None else first
    assert loop.fall is None and first == foot and loop.controller.at_rest


def test_pushes_one_after_another_are_survived_with_feet_fixed() -> None:
    """Each of 87 % of what a point mass could stand: the robot must be wholly at rest again before the next."""
    loop = standing(load_robot(disturbance={"step_when_standing": False}), 0)
    for direction, impulse in (("forward", 27.9), ("back", 27.9), ("right", 38.9)):
        loop.plant.push(impulse * np.array(DIRECTIONS[direction]), 0.1)
        until = loop.time + 4.0
        while loop.fall is None and loop.time < until:
            loop.step()
        assert loop.fall is None, direction
        error = loop.state.dcm_in_odom - loop.command.dcm_reference_in_odom
        assert np.hypot(error[0], error[1]) < 0.01
    assert loop.command.qp_failures == 0


def test_a_push_while_walking_is_survived() -> None:
    robot = load_robot()
    loop = standing(robot, 6)
    source = loop.request.steps = VelocitySteps(robot.tables.walking)
    pushes = {2.6: (0.0, 15.0, 0.0), 4.2: (-15.0, 0.0, 0.0)}  # at any time of the step
    until = loop.time + 6.0
    while loop.fall is None and loop.time < until:
        for time in [time for time in pushes if loop.time >= time]:
            loop.plant.push(np.array(pushes.pop(time)), 0.1)
        source.command(np.array((0.3, 0.0, 0.0)), loop.time)
        source.advance(loop.time)
        loop.step()
    assert loop.fall is None
    assert not pushes
    assert loop.command.qp_failures == 0


@pytest.mark.parametrize("foot", [LEFT, RIGHT])
def test_a_walking_robot_steps_at_once_after_a_step_that_does_not_reach_its_dcm(foot: int) -> None:
    loop = standing(load_robot(), 0)
    source = loop.request.steps = VelocitySteps(loop.robot.tables.walking)
    impulse = 0.7 * loop.robot.tables.size.mass * np.array((0.0, -1.0 if foot == LEFT else 1.0, 0.0))
    pushed, lifted = np.inf, np.inf
    while loop.fall is None and loop.time < min(pushed + 3.0, 20.0):
        source.command(np.array((0.3, 0.0, 0.0)), loop.time)
        source.advance(loop.time)
        loop.step()
        lifted = np.inf if loop.controller.swinging != foot else min(lifted, loop.time)
        if pushed == np.inf and loop.time > max(4.0, lifted + 0.15):
            loop.plant.push(impulse, 0.1)
            pushed = loop.time
    assert loop.fall is None and pushed < np.inf


def test_a_fall_is_reported_well_before_the_robot_hits_the_ground() -> None:
    """Even of a robot that tried to save itself by steps."""
    loop = standing(load_robot(), 7)
    loop.plant.push(np.array((0.0, 100.0, 0.0)), 0.1)
    until = loop.time + 3.0
    while loop.fall is None and loop.time < until:
        loop.step()
        assert not ground_contact(loop)
    assert loop.fall is not None
    reported, motors = loop.time, MotorCommand(loop.robot)
    while not ground_contact(loop) and loop.time < until:
        motors.limp(loop.plant.joint_position)
        loop.sequence += 1
        loop.plant.actuators.obey(motors.message(round(loop.time * 1e9), loop.sequence, 0, Behavior.FALL))
        loop.plant.step(loop.substeps)
    assert ground_contact(loop) and loop.time - reported > 0.15


def test_the_watch_reports_once_and_again_only_after_the_dcm_was_well_inside() -> None:
    loop = ClosedLoop(load_robot())
    loop.run(0.1)
    reference, time = loop.command.dcm_reference_in_odom, loop.state.time
    watch, table, foot = BalanceWatch(loop.robot), loop.robot.read(Tuning).disturbance, loop.robot.tables.feet.left
    edge = 0.5 * (foot.toe - foot.heel)

    def reported(forward: float, periods: int) -> int:
        """How often it reports a DCM so far before the middle, in so many periods."""
        nonlocal time
        count = 0
        for _ in range(periods):
            time += PERIOD
            dcm = reference + np.array((forward, 0.0, 0.0))
            count += watch.update(dataclasses.replace(loop.state, dcm_in_odom=dcm, time=time), reference)
        return count

    assert reported(edge - table.edge_margin - 0.01, 100) == 0
    assert reported(0.0, 10) == 0  # a jump of the estimate
    for forward in np.arange(1, 6) * 0.002:  # 1 m/s, from the middle
        assert reported(forward, 1) == 0
    assert reported(0.0, 10) == 0
    assert sum(reported(forward, 1) for forward in np.arange(1, 21) * 0.004) == 1  # 2 m/s: it will be outside
    assert reported(0.0, 10) == 0
    assert reported(edge - 0.005, 2) == 0  # that may be noise
    assert reported(0.0, 1) == 0 and reported(edge - 0.005, 100) == 1
    assert "inside the edge of the support polygon" in watch.reason
    assert reported(edge - table.edge_margin - 0.01, 100) == 0
    assert reported(edge + 0.01, 100) == 0  # it leans on something
    assert reported(0.0, 1) == 0 and reported(edge + 0.01, 100) == 1
    assert "outside" in watch.reason


def test_the_dcm_of_steps_has_what_stopping_the_angular_momentum_will_add() -> None:
    """ξ̇ = ω·(ξ − CoP) + (k̇_y, −k̇_x)·ω/(m·g), with k of the plant, of another mass than the model."""
    loop = standing(load_robot(), 0)
    loop.plant.push(np.array((30.0, 20.0, 0.0)), 0.1)
    loop.run(0.1)
    mj, data = loop.plant.model.mj, loop.plant.data
    mujoco.mj_subtreeVel(mj, data)
    base = loop.plant.model.body(loop.robot.tables.base)
    x, y, _ = data.subtree_angmom[base]
    height = data.subtree_com[base, 2] - loop.state.sole_positions_in_odom[:, 2].mean()
    added = np.array((y, -x, 0.0)) / (mj.body_subtreemass[base] * np.sqrt(9.81 * height))
    assert np.hypot(*added[:2]) > 0.01
    np.testing.assert_allclose(loop.controller._turning(), added, rtol=0.25, atol=0.003)
