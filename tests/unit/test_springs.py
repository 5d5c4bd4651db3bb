"""Series-elastic joints: the force loop against its theory, Newton, friction, and robots that stand on them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec import structs

from harness.closed_loop import ClosedLoop, load_robot
from harness.motion_states import motor
from valor.common.arrays import FloatArray
from valor.common.messages import JointMode
from valor.robot.description import RobotDescription
from valor.robot.tables import Springs
from valor.simulation.plant import Plant
from valor.simulation.springs import SeriesElastic
from valor.whole_body.walking.velocity_steps import VelocitySteps

ROBOT = load_robot()
STEP = ROBOT.tables.physics_step
BOTH = pytest.mark.parametrize("robot", [ROBOT, load_robot("thor")], ids=["escher", "thor"])


def table(robot: RobotDescription) -> Springs:
    springs = robot.tables.actuators["series_elastic"].springs
    assert springs is not None
    return springs


def locked(elastic: SeriesElastic, wanted: FloatArray, n: int) -> FloatArray:
    """(k, m) torques for (k,) set-points of all joints, which cannot move."""
    torques = []
    for value in wanted:
        elastic.update(np.full(n, value), np.zeros(n))
        torques.append(elastic.torque.copy())
    return np.array(torques)


@BOTH
def test_the_force_loop_has_its_bandwidth_with_the_joint_locked(robot: RobotDescription) -> None:
    """Half of the power at the table's frequency, nearly all a fourth of it; the motors alone would resonate below."""
    springs, n = table(robot), len(robot.joints)
    gain = {}
    for share in (0.25, 1.0, 2.0):
        elastic = SeriesElastic(robot, springs, np.zeros(n), 0.0, STEP)
        time = STEP * np.arange(3000)
        phase = math.tau * share * springs.bandwidth * time
        torque = locked(elastic, 5.0 * np.sin(phase), n)[1000:]
        gain[share] = np.abs(np.exp(-1j * phase[1000:]) @ torque) * 2 / torque.shape[0] / 5.0
    np.testing.assert_allclose(gain[0.25], 1.0, atol=0.06)
    np.testing.assert_allclose(gain[1.0], math.sqrt(0.5), rtol=0.06)
    np.testing.assert_allclose(gain[2.0], 0.25, rtol=0.25)


def test_the_spring_carries_what_moves_the_motor() -> None:
    """Newton and Hooke, with the joints turning: motor's torque − spring's = B·dv/dt, dτ/dt = k·(v − q̇)."""
    springs, n, rng = table(ROBOT), len(ROBOT.joints), np.random.default_rng(1)
    elastic = SeriesElastic(ROBOT, springs, np.zeros(n), 0.0, STEP)
    inertia = np.array([ROBOT.tables.joints[name].armature for name in springs.actuators])
    for _ in range(100):
        velocity = rng.normal(0, 0.2, n)
        torque, speed = elastic.torque.copy(), elastic.speed.copy()
        elastic.update(rng.normal(0, 20, n), velocity)
        stretched = elastic.stiffness * STEP * (speed - velocity[elastic.joints])
        np.testing.assert_allclose(elastic.torque - torque, stretched, atol=1e-9)
        np.testing.assert_allclose(elastic.drive - elastic.torque, inertia * (elastic.speed - speed) / STEP, atol=1e-9)


def test_the_observer_takes_the_ball_screws_friction_away() -> None:
    n = len(ROBOT.joints)
    friction = 5.0
    missing = {}
    for observer in (0.0, 20.0):
        springs = structs.replace(table(ROBOT), observer=observer)
        elastic = SeriesElastic(ROBOT, springs, np.full(n, friction), 0.0, STEP)
        missing[observer] = 10.0 - locked(elastic, np.full(1000, 10.0), n)[-1]
    assert missing[0.0].min() > 0.1 * friction and np.abs(missing[20.0]).max() < 0.02 * friction


@BOTH
def test_the_plants_springs_take_the_rotors_and_what_is_measured_is_theirs(robot: RobotDescription) -> None:
    plant = Plant(robot, "flat", "series_elastic", 0)
    elastic = plant.actuators.elastic
    assert elastic is not None
    for beyond in (plant.model.mj.dof_armature, plant.model.mj.dof_frictionloss):
        assert not beyond[plant.model.dof][elastic.joints].any()
    plant.actuators.obey(motor(robot, JointMode.POSITION))
    plant.step(500)
    np.testing.assert_array_equal(plant.actuators.effort[elastic.joints], elastic.torque)
    assert np.abs(plant.actuators.drive - plant.actuators.effort)[elastic.joints].max() > 0.1, "friction"
    others = np.setdiff1d(np.arange(len(robot.joints)), elastic.joints)
    np.testing.assert_array_equal(plant.actuators.drive[others], plant.actuators.effort[others])


@BOTH
def test_a_robot_on_springs_stands_walks_and_withstands_a_push(robot: RobotDescription) -> None:
    loop = ClosedLoop(robot, "series_elastic", 1)
    loop.settle(0.3)
    loop.run(1.0)
    walk = loop.request.steps = VelocitySteps(robot.tables.walking)
    start = loop.plant.data.qpos[0]

    def each(loop: ClosedLoop) -> None:
        walk.command(np.array((0.5, 0.0, 0.0)), loop.time)
        walk.advance(loop.time)

    loop.run(2.5, each)
    loop.plant.push(np.array((0.0, 15.0, 0.0)), 0.1)
    loop.run(2.0, each)
    assert loop.fall is None and loop.command.qp_failures == 0
    assert loop.plant.data.qpos[0] - start > 0.7
