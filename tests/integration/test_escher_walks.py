"""ESCHER walks by velocity and takes footsteps: real processes, plant and model different."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from harness.instance import RunningInstance
from harness.motion_system import STANDING, MotionSystem
from harness.waiting import wait_until
from valor.common.behaviors import Behavior
from valor.common.messages import (
    Footstep,
    FootstepPlanReply,
    FootstepPlanRequest,
    MotionState,
    StepStatus,
    VelocityCommand,
)
from valor.common.topics import FOOTSTEP_PLAN, GROUND_TRUTH, STEP_STATUS, VELOCITY

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
STEP_LENGTH = 0.2  # [m]


class WalkingSystem(MotionSystem):
    """A Motion System whose client walks it about."""

    def __init__(self, instance: RunningInstance) -> None:
        super().__init__(instance)
        node = instance.node("walker")
        self._place = GROUND_TRUTH.subscriber(node)
        self._velocity = VELOCITY.publisher(node)
        self._steps = STEP_STATUS.subscriber(node, queue=1000)
        self._plans = FOOTSTEP_PLAN.client(node)
        self.statuses: list[StepStatus] = []

    def place(self) -> np.ndarray:
        """(3,) of the true pelvis [m]."""
        position: np.ndarray = wait_until(self._place.latest, 10.0, "truth").message.pelvis_position_in_world
        return position

    def walk(self, forward: float, seconds: float) -> None:
        """Ask for a velocity [m/s] for a while of robot time [s]."""
        until = self.now() + round(seconds * 1e9)

        def over() -> bool:
            self._velocity.publish(VelocityCommand(time=self.now(), linear_x=forward, linear_y=0.0, angular_z=0.0))
            state = self.look()
            assert state is not None
            assert state.behavior == Behavior.WALK, state.reason
            return state.time >= until

        wait_until(over, 120.0, f"{seconds} s of walking", period=0.02)

    def plan(self, steps: list[Footstep]) -> FootstepPlanReply:
        return self._plans.call(FootstepPlanRequest(steps=steps), timeout=10.0)

    def status(self) -> StepStatus | None:
        """The newest; all are kept."""
        self.statuses += [received.message for received in self._steps.drain()]
        return self.statuses[-1] if self.statuses else None


def still(state: MotionState) -> bool:
    return bool(state.contacts.all() and np.abs(state.pelvis_linear_velocity_in_odom).max() < 0.01)


def footsteps(first: int, count: int, x: float) -> list[Footstep]:
    """Steps ahead from ``x``, left and right in turn, and a last one beside the one before."""
    steps = []
    for i in range(first, first + count):
        x += STEP_LENGTH if i < first + count - 1 else 0.0
        place = np.array([x, 0.1 if i % 2 == 0 else -0.1, 0.0])
        steps.append(Footstep(i, i % 2, place, LEVEL, 0.0, 0.0, 0.0))
    return steps


def test_walks_by_velocity_and_stops_when_nobody_commands(instance: RunningInstance) -> None:
    system = WalkingSystem(instance)
    system.stand()
    system.go(Behavior.WALK)
    before, estimated = system.place(), system.pass_time(0.1).pelvis_position_in_odom
    system.walk(0.3, 6.0)
    began = system.now()
    system.wait(lambda state: state.time > began + 3e9 and still(state), "standing still after silence", 120.0)
    state = system.pass_time(1.5)
    assert still(state)
    assert state.behavior == Behavior.WALK  # and waits for the next velocity
    way, believed = system.place() - before, state.pelvis_position_in_odom - estimated
    assert 1.2 < way[0] < 2.6
    assert abs(way[1]) < 0.2
    assert np.abs(believed - way).max() < 0.1
    assert system.request("stand").accepted
    system.wait_behavior(Behavior.STAND)
    assert system.height > STANDING
    assert not any(state.qp_failures for state in system.history)
    assert "fall" not in system.behaviors()


def test_takes_a_footstep_plan_changes_it_on_the_way_and_stands(instance: RunningInstance) -> None:
    system = WalkingSystem(instance)
    system.stand()
    assert "the behavior is stand" in system.plan(footsteps(0, 4, 0.0)).reason
    system.go(Behavior.STEP)
    far = footsteps(0, 4, 0.0)
    far[2].position_in_odom[0] += 1.0
    refused = system.plan(far)
    assert not refused.accepted
    assert "step 2 (left)" in refused.reason
    assert "forward" in refused.reason
    assert "begins with step 0" in system.plan(footsteps(1, 2, 0.0)).reason
    before = system.place()
    assert system.pass_time(0.3).behavior == Behavior.STEP
    reply = system.plan(footsteps(0, 4, 0.0))
    assert reply.accepted, reply.reason

    def executing(index: int) -> bool:
        status = system.status()
        return status is not None and status.executing_step_index == index

    wait_until(lambda: executing(1), 60.0, "step 1")
    moved = footsteps(1, 2, STEP_LENGTH)
    moved[0].position_in_odom[0] += 0.05
    assert "step 1 cannot be changed" in system.plan(moved).reason
    longer = footsteps(2, 4, 2 * STEP_LENGTH)
    reply = system.plan(longer)
    assert reply.accepted, reply.reason
    system.wait_behavior(Behavior.STAND, 120.0)
    finished: Any = wait_until(
        lambda: (status := system.status()) and status.state == "finished" and status, 10.0, "the plan finished"
    )
    assert finished
    assert (finished.last_performed_step_index, finished.queue_size, finished.executing_step_index) == (5, 0, -1)
    seen = [status.executing_step_index for status in system.statuses if status.executing_step_index >= 0]
    assert sorted(set(seen)) == list(range(6))
    assert seen == sorted(seen)
    wait_until(lambda: still(system.look() or system.pass_time(0.1)), 60.0, "standing still")
    way = system.place() - before
    assert way[0] == pytest.approx(5 * STEP_LENGTH, abs=0.05)
    assert abs(way[1]) < 0.05
    assert system.height > STANDING
    assert "fall" not in system.behaviors()
