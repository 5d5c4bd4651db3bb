"""The pelvis led from outside: within what the legs can do, never by a jump, and without losing the balance."""

from itertools import product
from types import SimpleNamespace
from typing import Any

import casadi as ca
import mujoco
import numpy as np
import pytest

from bifrost import Received
from harness.closed_loop import ClosedLoop, load_robot
from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.common.behaviors import Behavior
from valor.common.kernel import roll_pitch_yaw
from valor.common.messages import PelvisSetpoint
from valor.common.topics import PELVIS
from valor.control.kinematics import ModelJoints
from valor.motion_manager.behavior_fsm import BehaviorFsm
from valor.motion_manager.handlers.handler import RejectionCounter
from valor.motion_manager.handlers.motion import PelvisHandler
from valor.robot.commanded_limits import SPEED_MARGIN
from valor.robot.description import RobotDescription
from valor.robot.model import Model
from valor.whole_body.balance.pelvis import LegKinematics, PelvisReference


@pytest.fixture
def pelvis(model: Model) -> PelvisReference:
    return PelvisReference(model, ModelJoints(model).group("left_leg", "right_leg"))


class Bench:
    def __init__(self, pelvis: PelvisReference, *behaviors: Behavior) -> None:
        self.fsm, self.pelvis, self.rejections = BehaviorFsm(), pelvis, RejectionCounter()
        components: Any = SimpleNamespace(
            fsm=self.fsm, whole_body=SimpleNamespace(pelvis=pelvis), rejections=self.rejections
        )
        self.handler = PelvisHandler(components)
        for behavior in (Behavior.STAND_PREP, *behaviors):
            self.fsm.go(behavior, "test")

    def send(self, position: FloatArray, age: float = 0.0, velocity: FloatArray | None = None) -> bool:
        rate = np.zeros(6) if velocity is None else velocity
        message = PelvisSetpoint(time=round(1e9 * (5.0 - age)), position=position, velocity=rate)
        return self.handler.handle(Received(message, 0, 1, "somebody"), 5_000_000_000)

    def reason(self) -> str:
        (rejection,) = self.rejections.take()
        assert rejection.topic == PELVIS.name
        return rejection.reason


def test_roll_pitch_yaw_turn_about_fixed_axes_and_back() -> None:
    rng = np.random.default_rng(0)
    for angles in rng.uniform(-1.4, 1.4, (50, 3)):
        quaternion, matrix = np.zeros(4), np.zeros(9)
        mujoco.mju_euler2Quat(quaternion, angles, "XYZ")  # capital letters: fixed axes
        mujoco.mju_quat2Mat(matrix, quaternion)
        np.testing.assert_allclose(rotation.from_roll_pitch_yaw(*angles), matrix.reshape(3, 3), atol=1e-12)
        found = [float(angle) for angle in roll_pitch_yaw(ca.DM(matrix.reshape(3, 3)))]
        np.testing.assert_allclose(found, angles, atol=1e-9)


def test_the_legs_reach_every_corner_of_the_limits(model: Model, pelvis: PelvisReference) -> None:
    """Feet flat where they were, no joint at its limit."""
    joints = ModelJoints(model)
    legs = joints.group("left_leg", "right_leg")
    lower, upper = model.robot.lower[joints.places][legs], model.robot.upper[joints.places][legs]
    kinematics = LegKinematics(model, joints, legs)
    for corner in product(*zip(pelvis.limits.lower, pelvis.limits.upper, strict=True)):
        kinematics.reset()
        for share in np.minimum(1.0, np.arange(1, 31) / 20):
            place = pelvis.home + share * (corner - pelvis.home)
            kinematics.update(place, rotation.from_roll_pitch_yaw(*place[3:]))
        assert kinematics.solved, f"the soles left the ground at {corner}"
        assert ((kinematics.position > lower + 0.01) & (kinematics.position < upper - 0.01)).all(), corner


def test_a_distant_target_is_approached_within_the_limits(model: Model, pelvis: PelvisReference) -> None:
    table, dt = model.robot.tables.pelvis, model.robot.control_period
    pelvis.lead(np.array((0.05, -0.05, pelvis.limits.lower[2], 0.15, -0.25, 0.25)), np.zeros(6), 0.0)
    seen = []
    for k in range(2000):
        pelvis.advance(k * dt, dt)
        seen.append(np.concatenate((pelvis.position, pelvis.com_displacement)))
    velocity = np.diff(seen, axis=0) / dt
    acceleration = np.diff(velocity, axis=0) / dt
    assert np.abs(velocity[:, :3]).max() <= 1.001 * SPEED_MARGIN * table.max_speed
    assert np.abs(velocity[:, 3:6]).max() <= 1.001 * SPEED_MARGIN * table.max_turn_rate
    assert np.abs(acceleration[:, :3]).max() <= 1.01 * table.max_acceleration
    # The CoM goes down with the pelvis, by less: the feet stay.
    assert 0.6 < seen[-1][8] / -table.max_down < 1.0


def test_the_handler_clamps(pelvis: PelvisReference) -> None:
    bench = Bench(pelvis, Behavior.STAND)
    assert bench.send(np.array((1.0, -1.0, 0.0, 3.0, -3.0, 3.0)))
    for k in range(2000):
        pelvis.advance(5.0 + 0.002 * k, 0.002)
    upper = [1, 0, 0, 1, 0, 1]
    np.testing.assert_allclose(pelvis.position, np.where(upper, pelvis.limits.upper, pelvis.limits.lower), atol=1e-9)


@pytest.mark.parametrize(
    ("behaviors", "position", "age", "reason"),
    [
        ((), np.zeros(6), 0.0, "while the robot stands or steps; it is in stand_prep"),
        ((Behavior.STAND, Behavior.SOFT_STOP), np.zeros(6), 0.0, "it is in soft_stop"),
        ((Behavior.STAND,), np.zeros(5), 0.0, "position has 5 numbers; expected 6"),
        ((Behavior.STAND,), np.array((0, 0, np.nan, 0, 0, 0)), 0.0, "not finite"),
        ((Behavior.STAND,), np.zeros(6), 2.0, "made for a state 2.000 s old"),
        ((Behavior.STAND, Behavior.WALK), np.array((0.01, 0, 0.8, 0, 0, 0)), 0.0, "only the pelvis' height"),
    ],
)
def test_the_handler_refuses_and_nothing_moves(
    pelvis: PelvisReference, behaviors: tuple[Behavior, ...], position: FloatArray, age: float, reason: str
) -> None:
    bench = Bench(pelvis, *behaviors)
    assert not bench.send(position, age) and reason in bench.reason()
    pelvis.advance(5.0, 0.002)
    np.testing.assert_array_equal(pelvis.position, pelvis.home)


def test_the_height_is_led_while_the_robot_walks(pelvis: PelvisReference) -> None:
    bench = Bench(pelvis, Behavior.STAND, Behavior.WALK)
    assert bench.send(np.array((0.0, 0.0, 0.75, 0.0, 0.0, 0.0)))
    pelvis.advance(5.0, 0.002)
    assert pelvis.position[2] < pelvis.home[2] and pelvis.resting


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_it_follows_on_hardware(robot: RobotDescription, seed: int) -> None:
    """Down, turned and shifted, at the greatest speeds: the pelvis is there in the end, the balance never far off."""
    loop = ClosedLoop(load_robot(), "hardware", seed)
    loop.settle(0.3)
    loop.run(2.0)
    pelvis = loop.controller.pelvis
    target = pelvis.home + np.array((0.03, -0.03, -0.1, 0.08, 0.15, -0.2))
    pelvis.lead(target, np.zeros(6), loop.time)
    errors = []
    loop.run(4.5, lambda loop: errors.append(loop.state.dcm_in_odom - loop.command.dcm_reference_in_odom))
    away = np.abs(pelvis.measured(loop.state) - target)
    assert loop.fall is None and loop.controller.qp_failures == 0
    assert away[:3].max() < 0.03 and away[3:].max() < 0.05
    assert np.abs(np.array(errors)[:, :2]).max() < 0.04
