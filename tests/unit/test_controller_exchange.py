"""Controllers are exchanged while the robot stands and walks, and one that fails is replaced before the robot falls."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.closed_loop import load_robot
from harness.robot_in_process import RobotInProcess
from tests.unit.controllers import SPOILED, Spoiled, Statue
from valor.common.arrays import FloatArray
from valor.common.behaviors import Behavior, Locomotion
from valor.control.controller import Controller, JointCommand, Request
from valor.control.state import RobotState
from valor.motion_manager.locomotion import exchange
from valor.motion_manager.locomotion.exchange import WAITING, ControllerExchange, blended
from valor.robot.description import RobotDescription
from valor.robot.motion_tables import WHOLE_BODY

STEP = 0.15  # largest change of a joint's torque between two periods, fraction of its limit
N = 5


class Robot(RobotInProcess):
    """ESCHER in Stand, with another controller."""

    def __init__(
        self, make: Callable[[RobotDescription], Controller], names: tuple[str, ...] = (WHOLE_BODY, "statue", "spoiled")
    ) -> None:
        robot = load_robot(controllers={"stand": list(names), "walk": list(names)})
        super().__init__(robot, "hardware", 1, others=[lambda description, kinematics: make(description)])
        self.limit: FloatArray = robot.effort_limit
        assert not (refused := self.stand_up()), refused
        self.run(0.5)

    @property
    def exchange(self) -> ControllerExchange:
        return self.manager.components.exchange

    def choose(self, name: str) -> str:
        return self.exchange.choose(name, self.manager.components.state)

    def largest_step(self, seconds: float) -> float:
        """Largest change of a joint's torque between two periods, fraction of its limit."""
        largest, before = 0.0, self.plant.actuators.effort.copy()
        for _ in range(round(seconds / self._period)):
            self.step()
            largest = max(largest, float((np.abs(self.plant.actuators.effort - before) / self.limit).max()))
            before = self.plant.actuators.effort.copy()
        return largest


def test_controllers_are_exchanged_to_and_fro_without_a_jump() -> None:
    robot, rng = Robot(Statue), np.random.default_rng(3)
    for _ in range(4):
        for name in ("statue", WHOLE_BODY):
            assert not robot.choose(name)
            assert robot.largest_step(rng.uniform(0.6, 1.2)) < STEP
            assert robot.exchange.active.name == name and robot.behavior is Behavior.STAND


def test_the_first_of_the_list_takes_over_once_the_robot_balances() -> None:
    robot = Robot(Statue, ("statue", WHOLE_BODY))
    assert robot.largest_step(1.0) < STEP
    assert robot.exchange.active.name == "statue" and robot.behavior is Behavior.STAND


def test_arms_follow_their_targets_under_a_controller_of_the_legs() -> None:
    robot = Robot(Statue)
    assert not robot.choose("statue")
    robot.run(1.0)
    manager, name = robot.manager, "l_elbow_pitch"
    joint = manager.components.robot.index[name]
    goal = manager.components.robot.nominal_posture.copy()
    goal[joint] += 0.3
    mask = np.arange(goal.size) == joint
    manager.components.reference.move(mask, goal, 1e-9 * manager.time)
    robot.run(2.0)
    assert robot.exchange.active.name == "statue"
    assert abs(robot.measured.joint_position[joint] - goal[joint]) < 0.02


@pytest.mark.parametrize("what", SPOILED)
def test_who_fails_is_replaced_before_the_robot_falls(what: str) -> None:
    spoil, named = SPOILED[what]
    robot = Robot(lambda description: Spoiled(description, spoil))
    height = robot.plant.data.qpos[2]
    assert not robot.choose("spoiled")
    robot.run(0.8)
    assert robot.exchange.active.name == "spoiled"
    robot.run_until(lambda: robot.behavior is not Behavior.STAND, 6.0)
    assert robot.exchange.active.name == WHOLE_BODY
    assert robot.behavior is Behavior.SOFT_STOP, robot.manager.fsm.reason
    assert "spoiled: " in robot.manager.fsm.reason and named in robot.manager.fsm.reason
    assert abs(robot.plant.data.qpos[2] - height) < 0.05  # feet that stepped may be farther apart


def test_who_is_unsound_in_shadow_does_not_take_over() -> None:
    robot = Robot(lambda description: Spoiled(description, SPOILED["not a number"][0], sound=0.05))
    assert not robot.choose("spoiled")
    assert robot.largest_step(1.0) < STEP
    assert robot.exchange.active.name == WHOLE_BODY and robot.behavior is Behavior.STAND
    assert "does not take over" in robot.exchange.reason and "is not finite" in robot.exchange.reason


class Marching(Statue):
    """A statue that never comes to rest, as a policy that steps in place."""

    @property
    def at_rest(self) -> bool:
        return False


@pytest.mark.parametrize("inside", [exchange.INSIDE, 0.3])  # of the second no stance is capable
def test_from_one_that_does_not_rest_it_takes_over_between_steps(
    inside: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exchange, "INSIDE", inside)
    robot = Robot(Marching)
    assert not robot.choose("statue")
    robot.run(0.5)
    assert robot.exchange.active.name == "statue" and not robot.choose(WHOLE_BODY)
    robot.run(0.4 * WAITING)
    assert robot.exchange.active.name == "statue" and robot.exchange.pending
    assert robot.largest_step(0.65 * WAITING) < STEP
    assert robot.behavior is Behavior.STAND and not robot.exchange.pending
    if inside < 0.3:
        assert robot.exchange.active.name == WHOLE_BODY
        return
    assert robot.exchange.active.name == robot.exchange.chosen[Locomotion.STAND] == "statue"
    assert re.search(r"whole_body does not take over: the DCM is 0\.\d+ m inside", robot.exchange.reason)


class Yielding(Statue):
    """Servos that give way: sound at every state."""

    def update(self, state: RobotState, request: Request, dt: float) -> JointCommand | None:
        return replace(self.held, position=state.joint_position.copy(), effort=np.zeros_like(self.held.effort))


def test_a_walk_slows_down_before_another_controller_takes_over() -> None:
    robot = Robot(Yielding)
    assert not robot.ask(Behavior.WALK)
    robot.walk((0.3, 0.0, 0.0), 3.0)
    steps, period = robot.manager.components.velocity_steps, robot.manager.components.robot.control_period
    assert steps.velocity[0] == pytest.approx(0.3) and not robot.choose("statue")
    while robot.exchange.active.name == WHOLE_BODY and robot.time < 10.0:
        robot.walk((0.3, 0.0, 0.0), period)
    assert robot.exchange.active.name == "statue" and steps.velocity[0] < 0.2
    robot.run(exchange.BLEND + period)
    assert not steps.velocity.any()  # the next walk starts from rest


def test_soft_stop_asks_no_controller() -> None:
    robot = Robot(Statue)
    assert not robot.choose("statue")
    robot.run(1.0)
    assert robot.exchange.active.name == "statue" and not robot.ask(Behavior.SOFT_STOP)
    robot.run(0.1)
    assert robot.exchange.active.name == WHOLE_BODY


def test_unknown_names_are_rejected_with_the_known_ones() -> None:
    robot = Robot(Statue)
    assert "stand: whole_body, statue" in robot.choose("nobody") and robot.choose("spoiled")


vectors = st.integers(0, 2**32 - 1).map(lambda seed: np.random.default_rng(seed).normal(size=(7, N)))


@given(vectors, vectors, st.floats(0.0, 1.0))
def test_torques_are_blended_linearly_at_any_state(one: FloatArray, other: FloatArray, share: float) -> None:
    def command(rows: FloatArray) -> JointCommand:
        return JointCommand(rows[0], rows[1], rows[2], np.maximum(rows[3], 0.0), np.maximum(rows[4], 0.0))

    def torque(command: JointCommand) -> FloatArray:
        position, velocity = one[5:]
        servo = command.stiffness * (command.position - position) + command.damping * (command.velocity - velocity)
        total: FloatArray = command.effort + servo
        return total

    first, second = command(one), command(other)
    expected = (1.0 - share) * torque(first) + share * torque(second)
    np.testing.assert_allclose(torque(blended(first, second, share)), expected, atol=1e-9)
