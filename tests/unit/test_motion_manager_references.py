"""What the Motion Manager makes of the time and the load that it is given: where a mistake shows late, or little."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bifrost import Received
from harness.places import ROBOTS
from harness.still_robot import ROBOT, Robot
from harness.waiting import some
from tests.unit.test_motion_manager_footsteps import ahead
from tests.unit.test_motion_manager_setpoints import ARM, Bench
from valor.common.behaviors import Behavior
from valor.common.messages import FootstepPlanRequest, Rejection, VelocityCommand
from valor.common.topics import DEVICES, SERVICE_TOPICS, TOPICS
from valor.motion_manager.behavior_fsm import BehaviorFsm
from valor.motion_manager.handlers.footstep_plan import FootstepPlanHandler
from valor.motion_manager.handlers.handler import STALE, Handler, RejectionCounter, make_all
from valor.motion_manager.handlers.motion import VelocityHandler
from valor.motion_manager.joints.joint_reference import SETPOINT_HORIZON
from valor.motion_manager.manager import MotionManager
from valor.robot.description import RobotDescription
from valor.robot.model import controller_model
from valor.whole_body.walking.footsteps import level_pose
from valor.whole_body.walking.velocity_steps import VelocitySteps


@pytest.mark.parametrize("age", [0.0, 0.25 * SETPOINT_HORIZON, 0.8 * SETPOINT_HORIZON])
def test_a_set_point_runs_on_from_the_moment_that_it_was_made_for(age: float) -> None:
    """And comes to rest where its velocity takes it within the horizon, however late it was received."""
    bench = Bench(Behavior.STAND_MANIPULATE)
    bench.run(0.5)
    joints = [ROBOT.index[name] for name in ARM]
    here = bench.reference.position[joints]
    speed = 0.2 * ROBOT.velocity_limit[joints]
    assert bench.send(bench.message(list(ARM), here, speed, age=age))
    bench.run(0.5)
    np.testing.assert_allclose(bench.reference.position[joints], here + SETPOINT_HORIZON * speed, atol=1e-6)
    assert not bench.reference.velocity[joints].any()


@pytest.mark.parametrize(("foot", "aside"), [("left", -0.1), ("right", 0.1)])
def test_a_foot_that_does_not_touch_has_no_part_in_the_centre_of_pressure(foot: str, aside: float) -> None:
    robot = Robot()
    robot.run(1.0)
    assert not robot.ask(Behavior.STAND)
    robot.run(0.1)
    state = some(robot.manager.components.state)
    np.testing.assert_allclose(state.cop_in_odom, [0.02, 0.0], atol=1e-9)
    for _ in range(100):
        robot.tick(**dict[str, Any]({f"{foot}_foot_wrench": np.zeros(6)}))
        state = some(robot.manager.components.state)
        if state.contacts.sum() == 1:
            break
    np.testing.assert_allclose(state.cop_in_odom, [0.02, aside], atol=1e-6)


# What comes in from outside has one handler a topic.
NAME = "motion_manager"


@pytest.fixture(scope="module")
def manager() -> MotionManager:
    robot = RobotDescription.load(ROBOTS / "escher")
    return MotionManager(robot, controller_model(robot))


def test_every_topic_for_the_motion_manager_has_one_handler(manager: MotionManager) -> None:
    received = sorted(handler.topic.name for handler in make_all(manager.components))
    commands = [topic.name for topic in TOPICS if topic.name.startswith(f"{NAME}/") and topic.owner != NAME]
    requests = [topic.name for topic in SERVICE_TOPICS if topic.owner == NAME]
    assert received == sorted([*commands, *requests, DEVICES.name])


def test_what_counts_message_by_message_waits_in_a_queue(manager: MotionManager) -> None:
    for handler in make_all(manager.components):
        if isinstance(handler, Handler) and not handler.after_motor:
            assert handler.topic.queue, handler.topic.name


# Who may make the robot walk, and what becomes of the behavior when there is nothing left to walk.
NOW = 20_000_000_000  # robot time [ns]
WALKING = (Behavior.STAND_PREP, Behavior.STAND, Behavior.WALK)


class Steering:
    def __init__(self, *path: Behavior) -> None:
        self.fsm = BehaviorFsm()
        for behavior in path:
            self.fsm.go(behavior, "test")
        self.steps = VelocitySteps(ROBOT.tables.walking)
        self.rejections = RejectionCounter()
        components: Any = SimpleNamespace(fsm=self.fsm, velocity_steps=self.steps, rejections=self.rejections)
        self._handler = VelocityHandler(components)

    def send(self, *velocity: float, age: float = 0.0) -> bool:
        message = VelocityCommand(NOW - round(1e9 * age), *velocity)
        return self._handler.handle(Received(message, 0, 1, "somebody"), NOW)

    @property
    def walks(self) -> bool:
        """True if there are steps to be taken."""
        return bool(self.steps.upcoming([level_pose(0.0, y, 0.0, 0.0) for y in (0.1, -0.1)]))

    def refusal(self) -> Rejection:
        (rejection,) = self.rejections.take()
        assert rejection.origin == "somebody"
        assert not self.walks
        return rejection


PATHS: tuple[tuple[Behavior, ...], ...] = (
    (), WALKING[:1], WALKING[:2], (*WALKING[:2], Behavior.STAND_MANIPULATE), (*WALKING[:2], Behavior.STEP),
    (*WALKING[:2], Behavior.STEP, Behavior.STEP_MANIPULATE), (*WALKING, Behavior.SOFT_STOP),
    (*WALKING, Behavior.FALL), (Behavior.FREEZE,),
)  # fmt: skip


@pytest.mark.parametrize("path", PATHS)
def test_a_velocity_moves_no_robot_that_does_not_walk(path: tuple[Behavior, ...]) -> None:
    steering = Steering(*path)
    assert steering.fsm.behavior is (path[-1] if path else Behavior.IDLE)
    assert not steering.send(0.2, 0.0, 0.0) and steering.refusal().reason.endswith(f"it is {steering.fsm.behavior}")


@pytest.mark.parametrize("path", [WALKING, (*WALKING, Behavior.WALK_MANIPULATE)])
def test_a_velocity_is_followed_in_both_behaviors_that_walk(path: tuple[Behavior, ...]) -> None:
    steering = Steering(*path)
    assert not steering.walks and steering.send(0.2, 0.0, 0.0) and steering.walks and not steering.rejections.take()


@pytest.mark.parametrize("place", range(3))
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_velocity_that_is_no_number_is_refused(place: int, value: float) -> None:
    steering = Steering(*WALKING)
    velocity = np.zeros(3)
    velocity[place] = value
    assert not steering.send(*velocity.tolist()) and str(velocity.tolist()) in steering.refusal().reason


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_velocity_for_another_moment_is_refused_whichever_way_the_clock_is_wrong(sign: float) -> None:
    steering = Steering(*WALKING)
    assert not steering.send(0.2, 0.0, 0.0, age=sign * (STALE + 0.01))
    assert f"{sign * (STALE + 0.01):.3f} s old" in steering.refusal().reason
    assert steering.send(0.2, 0.0, 0.0, age=sign * (STALE - 0.01))


@pytest.mark.parametrize("path", [(Behavior.STEP,), (Behavior.STEP, Behavior.STEP_MANIPULATE)])
def test_a_plan_that_is_stopped_before_it_began_ends_in_stand(path: tuple[Behavior, ...]) -> None:
    robot = Robot()
    robot.run(1.0)
    for behavior in (Behavior.STAND, *path):
        assert not robot.ask(behavior)
        robot.tick()
    plan = FootstepPlanHandler(robot.manager.components)
    assert plan.handle(FootstepPlanRequest(steps=ahead(0, 3)), "somebody").accepted
    assert plan.handle(FootstepPlanRequest(steps=[]), "somebody").accepted
    robot.tick()
    assert robot.behavior is Behavior.STAND and robot.manager.fsm.reason == "stopped by somebody"
