"""The thesis' PD control of the arms: offsets at rest by the weight, and the VRC's controller against them."""

import mujoco
import numpy as np
import pytest
from msgspec import structs

from harness.closed_loop import load_robot
from harness.streamed_robot import StreamedRobot
from valor.common.arrays import FloatArray
from valor.common.behaviors import Behavior
from valor.robot.kinematic_tree import KinematicTree
from valor.robot.model import full_model
from valor.valor_ros_controller.controller_manager import Controller, ControllerManager, ControllerSwitch
from valor.valor_ros_controller.controllers.gravity_offset import GravityOffset, Weights
from valor.valor_ros_controller.controllers.table import ControllersTable
from valor.valor_ros_controller.trajectory.waypoints import Point

FORWARD = (-0.9, 0.1, 0.0, 0.9, 0.0, 0.0, 0.0)  # preset of the left arm [rad]
PITCH = [0, 3, 5]  # of shoulder, elbow and wrist
CYCLE = 0.004  # of the VRC [s]
FRICTION = 1.5  # [N·m]
FASTEST = 0.3  # of set-points when the offset is switched [rad/s]


class OffsetRobot(StreamedRobot):
    """A robot with PD control, masses 5 % off; ``offset``: the VRC's controller of its arms, inactive."""

    def __init__(self) -> None:
        super().__init__(load_robot(arm_control="pd"))
        self.offset = gravity_offset(self)
        self.sent: list[FloatArray] = []  # set-points, of each cycle

    def step(self) -> None:
        """After the trajectory controller, as in the VRC."""
        super().step()
        if hasattr(self, "offset"):
            self.offset.update(self.hw)
            self.sent.append(self.manager.components.reference.position[self.controller.joints])


def gravity_offset(robot: StreamedRobot) -> GravityOffset:
    config = ControllersTable.load().robot_controllers["gravity_offset"]
    return GravityOffset("gravity_offset", config, robot.hw, KinematicTree.load(robot.robot))


@pytest.fixture(scope="module")
def robot() -> OffsetRobot:
    """Its left arm stretched forward."""
    robot = OffsetRobot()
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


def test_an_arm_hangs_below_its_set_points_by_its_weight(robot: OffsetRobot) -> None:
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


def test_gravity_offset_lifts_it_and_is_switched_without_a_step(robot: OffsetRobot) -> None:
    hanging = run(robot, 0.5)
    robot.sent.clear()
    robot.offset.start(robot.hw)
    lifted = run(robot, 1.5)
    assert (np.abs(lifted[PITCH]) < 0.2 * np.abs(hanging[PITCH])).all(), lifted[PITCH] / hanging[PITCH]
    held = robot.controller.position.copy()
    for _ in range(3):  # as mode stop: the offset is not taken for a part of the Motion System's set-point
        robot.controller.stop(robot.hw, "test")
        robot.controller.start(robot.hw)
        run(robot, 0.2)
    np.testing.assert_allclose(robot.controller.position, held, atol=0.002)
    bad = structs.replace(robot.measured, imu_orientation=np.full(4, np.nan))
    target = robot.offset._target.copy()
    robot.hw.measured = bad
    robot.offset._compute(robot.hw)
    assert (robot.offset._target == target).all() and np.isfinite(target).all()
    robot.offset.stop(robot.hw, "test")
    np.testing.assert_allclose(run(robot, 1.5), hanging, atol=0.015)
    assert np.abs(np.diff(robot.sent, axis=0)).max() / robot.robot.control_period < FASTEST


@pytest.mark.parametrize("name", ["escher", "thor"])
def test_the_weights_of_the_arms_are_the_models(name: str) -> None:
    robot, random = load_robot(name), np.random.default_rng(0)
    joints = [joint for arm in ("left_arm", "right_arm") for joint in robot.tables.group(arm)]
    model = full_model(robot)
    data = mujoco.MjData(model.mj)
    position = random.uniform(-0.5, 0.5, len(robot.joints))
    data.qpos[:] = model.nominal_qpos()
    data.qpos[3:7] = random.normal(size=4)
    data.qpos[model.qpos] = position[model.joint_indices]
    mujoco.mj_forward(model.mj, data)
    up = data.xmat[model.body(robot.tables.base)].reshape(3, 3)[2]
    torques = Weights(KinematicTree.load(robot), joints, robot.index).torques(position, up)
    places = [int(model.mj.joint(joint).dofadr[0]) for joint in joints]
    np.testing.assert_allclose(torques, data.qfrc_bias[places], atol=1e-9)


def test_an_optional_controller_is_off_until_a_client_asks_and_then_stays(robot: OffsetRobot) -> None:
    always, hw = Controller(), robot.hw
    always.name = "always"
    manager = ControllerManager("robot", [always, gravity_offset(robot)])
    switch = ControllerSwitch((ControllerManager("mode", []), manager), hw)
    manager.enter("a", ["always"], hw, "", optional=["gravity_offset"])
    assert manager.active == ("always",)
    assert switch.switch(["gravity_offset"], [], 2) == (True, "")
    for mode, restart in (("b", False), ("b", True)):
        manager.enter(mode, ["always"], hw, "", optional=["gravity_offset"], restart=restart)
        assert manager.active == ("always", "gravity_offset")
    manager.enter("freeze", ["always"], hw, "")
    assert manager.active == ("always",) and not switch.switch(["gravity_offset"], [], 2)[0]
    compensated = GravityOffset("g", ControllersTable.load().robot_controllers["gravity_offset"], hw, None)
    assert "expected arm_control: pd" in compensated.obstacle


def test_no_joint_steps_when_balance_ends(robot: OffsetRobot) -> None:
    before, fastest = robot.arm, 0.0
    assert not robot.ask(Behavior.STAND)
    robot.run(0.1)
    assert not robot.ask(Behavior.FREEZE)
    for _ in range(100):
        robot.step()
        fastest = max(fastest, float(np.abs(robot.arm - before).max()))
        before = robot.arm
    assert fastest < 0.004, "per period [rad]"
