"""Who may make the robot walk, and what becomes of the behavior when there is nothing left to walk."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bifrost import Received
from harness.robot_in_process import RobotInProcess
from harness.still_robot import ROBOT, Robot
from tests.unit.test_motion_manager_footsteps import ahead, footstep
from valor.common.behaviors import Behavior
from valor.common.messages import FootstepPlanRequest, Rejection, VelocityCommand
from valor.motion_manager.handlers.footstep_plan import FootstepPlanHandler
from valor.motion_manager.handlers.handler import STALE
from valor.motion_manager.handlers.rejections import Rejections
from valor.motion_manager.handlers.velocity import VelocityHandler
from valor.motion_manager.states.behavior_fsm import BehaviorFsm
from valor.whole_body.walking.footsteps import level_pose
from valor.whole_body.walking.velocity_steps import VelocitySteps

NOW = 20_000_000_000  # robot time [ns]
WALKING = (Behavior.STAND_PREP, Behavior.STAND, Behavior.WALK)


class Steering:
    """The handler, and the steps that it leads."""

    def __init__(self, *path: Behavior) -> None:
        self.fsm = BehaviorFsm()
        for behavior in path:
            self.fsm.go(behavior, "test")
        self.steps = VelocitySteps(ROBOT.tables.walking)
        self.rejections = Rejections()
        self._handler = VelocityHandler(self.fsm, self.steps, self.rejections)

    def send(self, *velocity: float, age: float = 0.0) -> bool:
        message = VelocityCommand(NOW - round(1e9 * age), *velocity)
        return self._handler.handle(Received(message, 0, 1, "somebody"), NOW)

    @property
    def walks(self) -> bool:
        """Whether there are steps to be taken."""
        return bool(self.steps.upcoming([level_pose(0.0, y, 0.0, 0.0) for y in (0.1, -0.1)]))

    def refusal(self) -> Rejection:
        (rejection,) = self.rejections.take()
        assert rejection.origin == "somebody"
        assert not self.walks
        return rejection


PATHS: tuple[tuple[Behavior, ...], ...] = (
    (),
    WALKING[:1],
    WALKING[:2],
    (*WALKING[:2], Behavior.STAND_MANIPULATE),
    (*WALKING[:2], Behavior.STEP),
    (*WALKING[:2], Behavior.STEP, Behavior.STEP_MANIPULATE),
    (*WALKING, Behavior.SOFT_STOP),
    (*WALKING, Behavior.FALL),
    (Behavior.FREEZE,),
)


@pytest.mark.parametrize("path", PATHS)
def test_a_velocity_moves_no_robot_that_does_not_walk(path: tuple[Behavior, ...]) -> None:
    steering = Steering(*path)
    assert steering.fsm.behavior is (path[-1] if path else Behavior.IDLE)
    assert not steering.send(0.2, 0.0, 0.0)
    assert steering.refusal().reason.endswith(f"it is {steering.fsm.behavior}")


@pytest.mark.parametrize("path", [WALKING, (*WALKING, Behavior.WALK_MANIPULATE)])
def test_a_velocity_is_followed_in_both_behaviors_that_walk(path: tuple[Behavior, ...]) -> None:
    steering = Steering(*path)
    assert not steering.walks
    assert steering.send(0.2, 0.0, 0.0)
    assert steering.walks
    assert not steering.rejections.take()


@pytest.mark.parametrize("place", range(3))
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_velocity_that_is_no_number_is_refused(place: int, value: float) -> None:
    steering = Steering(*WALKING)
    velocity = np.zeros(3)
    velocity[place] = value
    assert not steering.send(*velocity.tolist())
    assert str(velocity.tolist()) in steering.refusal().reason


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
    plan = FootstepPlanHandler.of(robot.manager.parts)
    assert plan.handle(FootstepPlanRequest(steps=ahead(0, 3)), "somebody").accepted
    assert plan.handle(FootstepPlanRequest(steps=[]), "somebody").accepted
    robot.tick()
    assert robot.behavior is Behavior.STAND
    assert robot.manager.fsm.reason == "stopped by somebody"


def test_a_plan_that_is_walked_to_its_end_ends_in_stand() -> None:
    robot = RobotInProcess(ROBOT, "ideal", 0)
    assert robot.run_until(lambda: not robot.ask(Behavior.STAND), 10.0)
    assert not robot.ask(Behavior.STEP)
    robot.run(0.1)
    place = robot.manager.parts.soles()[0].position
    step = footstep(0, 0, float(place[0]), float(place[1]), swing_duration=0.5, transfer_duration=0.3)
    reply = FootstepPlanHandler.of(robot.manager.parts).handle(FootstepPlanRequest(steps=[step]), "somebody")
    assert reply.accepted, reply.reason
    seen: list[str] = []

    def ended() -> bool:
        seen.append(robot.manager.parts.step_queue.status(0).state)
        return robot.behavior is not Behavior.STEP

    assert robot.run_until(ended, 10.0)
    assert (robot.behavior, robot.manager.fsm.reason) == (Behavior.STAND, "the footstep plan is done")
    assert (set(seen), seen[-1]) == ({"executing", "finished"}, "finished")
    assert not robot.manager.parts.conditions().stepping
