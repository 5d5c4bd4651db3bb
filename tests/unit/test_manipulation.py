"""Fixtures that hands turn, and plans for them: what holds, what gives way, and that a plan is what was seen alone."""

import math
from collections.abc import Mapping
from dataclasses import replace

import msgspec
import mujoco
import numpy as np
import pytest

from harness.closed_loop import load_robot
from valor.common.errors import ValorError
from valor.common.poses import Pose, level
from valor.manipulation import door, seen, valve
from valor.manipulation.known import TASKS
from valor.manipulation.plan import HandShape
from valor.robot.description import RobotDescription
from valor.simulation import worlds
from valor.simulation.worlds.fixtures import Door

ESCHER = load_robot()
SEEDS = range(4)
EDGE, HELD, OPEN = 60.0, math.radians(0.5), math.radians(10.0)  # torque that tries the latch [N·m]; of the leaf
SERVO = (40.0, 0.3)  # that holds a joint of a fixture [N·m/rad, N·m·s/rad]

every_task = pytest.mark.parametrize("task", TASKS)


class Fixture:
    def __init__(self, world: str, seed: int = 0) -> None:
        self.model = worlds.load(world, seed).compile()
        self.model.opt.timestep = ESCHER.tables.physics_step
        self.data = mujoco.MjData(self.model)

    def angle(self, joint: str) -> float:
        return float(self.data.joint(joint).qpos[0])

    def run(self, seconds: float, torque: Mapping[str, float], held: Mapping[str, float] | None = None) -> None:
        """So long, under torques on joints [N·m], others held at angles [rad]."""
        stiffness, damping = SERVO
        for _ in range(round(seconds / self.model.opt.timestep)):
            for name, each in torque.items():
                self.data.joint(name).qfrc_applied[0] = each
            for name, wanted in (held or {}).items():
                joint = self.data.joint(name)
                joint.qfrc_applied[0] = stiffness * (wanted - joint.qpos[0]) - damping * joint.qvel[0]
            mujoco.mj_step(self.model, self.data)


@pytest.mark.parametrize("turned", [0.0, 10.0, 20.0, None])
def test_the_latch_holds_the_leaf_until_the_lever_is_turned(turned: float | None) -> None:
    world = worlds.WORLDS["door"]
    assert isinstance(world, Door)
    fixture = Fixture("door")
    angle = world.unlatch + math.radians(4.0) if turned is None else math.radians(turned)
    fixture.run(1.0, {"leaf": EDGE}, {"lever": angle})
    if turned is None:
        assert fixture.angle("leaf") > OPEN
    else:
        assert fixture.angle("leaf") < HELD and fixture.angle("lever") == pytest.approx(angle, abs=math.radians(3.0))


def test_the_lever_springs_back_and_the_leaf_stays_where_it_was_pushed() -> None:
    fixture = Fixture("door")
    fixture.run(0.5, {"leaf": 0.0}, {"lever": math.radians(45.0)})
    assert fixture.angle("lever") > math.radians(35.0)
    fixture.run(1.0, {"leaf": 10.0, "lever": 0.0})
    assert abs(fixture.angle("lever")) < math.radians(2.0) and fixture.angle("leaf") < HELD


def test_the_wheel_is_held_by_its_friction_and_turns_round_and_round_beyond_it() -> None:
    fixture = Fixture("valve")
    fixture.run(1.0, {"wheel": 1.5})
    assert abs(fixture.angle("wheel")) < math.radians(2.0)
    fixture.run(6.0, {"wheel": 4.0})
    assert fixture.angle("wheel") > valve.TURN


@every_task
def test_what_moves_in_a_world_is_no_ground(task: str) -> None:
    grid = np.linspace(-0.5, 0.45, 5)
    for seed in SEEDS:
        np.testing.assert_allclose(worlds.heights(task, seed, grid, grid), 0.0, atol=1e-9)


def test_what_is_seen_is_off_by_no_more_than_is_said_and_never_exact() -> None:
    for seed in SEEDS:
        world = worlds.WORLDS["door"]
        assert isinstance(world, Door)
        true, believed = world.pose(worlds.stream(seed)), seen.door(ESCHER, seed).frame
        start = Pose((-0.012, 0.0, 0.0))  # of odom in the world, as docs/comms_manager.md states
        off = (start.inverse() @ true).inverse() @ believed
        for error in off.position:
            assert 0.0 < abs(error) < 1.5 * seen.PLACE  # turned by the fixture's heading
        assert 0.0 < abs(off.yaw) <= seen.TURN


@every_task
def test_a_plan_follows_from_what_is_seen_alone(task: str) -> None:
    for seed in SEEDS:
        assert TASKS[task].plan(ESCHER, seed) == TASKS[task].plan(ESCHER, seed)
    assert TASKS[task].plan(ESCHER, 0) != TASKS[task].plan(ESCHER, 1)


@pytest.mark.parametrize("moved", [level(0.4, -0.3, 0.02, 0.5), level(-2.0, 1.0, 0.0, -2.5)])
def test_a_fixture_that_stands_elsewhere_takes_the_whole_plan_with_it(moved: Pose) -> None:
    """Stance and goals are seen from the fixture: none of them knows where odom is."""
    at_door, at_valve = seen.door(ESCHER, 1), seen.valve(ESCHER, 1)
    pairs = [
        (door.plan(ESCHER, at_door), door.plan(ESCHER, replace(at_door, frame=moved @ at_door.frame))),
        (valve.plan(ESCHER, at_valve), valve.plan(ESCHER, replace(at_valve, frame=moved @ at_valve.frame))),
    ]
    for here, there in pairs:
        x, y, yaw = here.stance
        stance = moved @ level(x, y, 0.0, yaw)
        assert there.stance[:2] == pytest.approx(stance.position[:2])
        assert math.remainder(there.stance[2] - stance.yaw, math.tau) == pytest.approx(0.0, abs=1e-9)
        for one, other in zip(here.moves, there.moves, strict=True):
            expected = moved @ one.hand
            assert other.hand.position == pytest.approx(expected.position)
            assert abs(np.dot(other.hand.orientation, expected.orientation)) == pytest.approx(1.0)


def test_the_fist_comes_from_above_the_lever_presses_it_beyond_its_latch_and_then_pushes() -> None:
    at = seen.door(ESCHER, 2)
    moves = door.plan(ESCHER, at).moves
    ahead, over, turned, *pushes = [(at.frame.inverse() @ move.hand).position for move in moves]
    assert ahead[0] < over[0]
    edge = HandShape.of(ESCHER, door.NAME, door.FINGERS).bottom
    assert ahead[2] > over[2] > at.handle_height - edge > turned[2] and turned[:2] == pytest.approx(over[:2])
    assert all(one[0] < other[0] for one, other in zip([turned, *pushes], pushes, strict=False))
    assert math.atan2(pushes[-1][0], at.hinge) > OPEN


def test_a_robot_that_cannot_is_refused_in_one_line_that_names_what_is_missing() -> None:
    hands = msgspec.structs.replace(ESCHER.tables.hands, right=None)
    handless = RobotDescription(ESCHER.folder, msgspec.structs.replace(ESCHER.tables, hands=hands, devices={}))
    without_fingers = load_robot(hand_presets={"close": {}, "open": {}})
    for name, task in TASKS.items():
        for robot, missing in ((handless, "no right hand"), (without_fingers, "no preset")):
            with pytest.raises(ValorError, match=rf"^{name}: robot 'escher' has {missing}[^\n]*; expected one$"):
                task.plan(robot, 0)


def test_an_arm_that_is_too_short_is_refused_with_both_lengths() -> None:
    far = replace(seen.door(ESCHER, 0), handle_height=2.2)
    with pytest.raises(
        ValorError, match=r"^door: the right arm of 'escher' is 0\.79 m long; expected at least 1\.\d\d m"
    ):
        door.plan(ESCHER, far)
