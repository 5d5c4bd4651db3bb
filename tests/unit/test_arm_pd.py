"""The thesis' PD control of the arms: offsets at rest by the weight."""

import numpy as np
import pytest

from harness.closed_loop import load_robot
from harness.streamed_robot import StreamedRobot
from valor.common.arrays import FloatArray
from valor.common.behaviors import Behavior
from valor.valor_ros_controller.trajectory.waypoints import Point

FORWARD = (-0.9, 0.1, 0.0, 0.9, 0.0, 0.0, 0.0)  # preset of the left arm [rad]
PITCH = [0, 3, 5]  # of shoulder, elbow and wrist
CYCLE = 0.004  # of the VRC [s]
FRICTION = 1.5  # [N·m]


@pytest.fixture(scope="module")
def robot() -> StreamedRobot:
    """With PD control, masses 5 % off; its left arm stretched forward."""
    robot = StreamedRobot(load_robot(arm_control="pd"))
    robot.submit([Point(list(FORWARD), [], [], [], 1.5)])
    run(robot, 3.0)
    return robot


def run(robot: StreamedRobot, seconds: float) -> FloatArray:
    """Let so long pass; returns the mean offset of the arm from its set-points in the last half second [rad]."""
    offsets = []
    for _ in range(round(seconds / CYCLE)):
        robot.cycle()
        offsets.append(robot.arm - robot.controller.position)
    mean: FloatArray = np.mean(offsets[-round(0.5 / CYCLE) :], axis=0)
    return mean


def test_an_arm_hangs_below_its_set_points_by_its_weight(robot: StreamedRobot) -> None:
    offset, tables = run(robot, 0.5), robot.robot.tables
    joints, gains = robot.controller.joints, tables.arm_pd
    assert (offset[PITCH] > 0.03).all() and np.abs(offset[PITCH]).max() < 0.2
    data, motor = robot.plant.data, robot.motor
    weight = data.qfrc_bias[np.arange(robot.plant.model.mj.nv)[robot.plant.model.dof][joints]]
    carried = gains.stiffness(robot.robot.servo_stiffness, robot.robot.servo_damping)[joints] * -offset
    np.testing.assert_allclose(carried, weight, atol=FRICTION)
    np.testing.assert_allclose(motor.velocity[joints], -gains.gain * offset, atol=0.02)  # constant
    np.testing.assert_allclose(motor.position[joints] - robot.arm, -gains.horizon * gains.gain * offset, atol=0.004)
    assert not motor.effort[joints].any()


def test_no_joint_steps_when_balance_ends(robot: StreamedRobot) -> None:
    before, fastest = robot.arm, 0.0
    assert not robot.ask(Behavior.STAND)
    robot.run(0.1)
    assert not robot.ask(Behavior.FREEZE)
    for _ in range(100):
        robot.step()
        fastest = max(fastest, float(np.abs(robot.arm - before).max()))
        before = robot.arm
    assert fastest < 0.004, "per period [rad]"
