"""Footstep plans at the Motion Manager: taken whole or not at all, changed where they can be, stopped feet together."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from harness.places import ROBOTS
from harness.waiting import some
from valor.common.behaviors import Behavior
from valor.common.messages import Footstep, FootstepPlanRequest, StepStatus
from valor.control.steps import Step
from valor.motion_manager.behavior_fsm import BehaviorFsm
from valor.motion_manager.handlers.footstep_plan import FootstepPlanHandler
from valor.motion_manager.handlers.handler import RejectionCounter
from valor.robot.description import RobotDescription
from valor.whole_body.walking.footsteps import StepQueue, level_pose

ROBOT = RobotDescription.load(ROBOTS / "escher")


class Bench:
    """Handler and queue, and in the gait's place a walker that takes each step exactly."""

    def __init__(self) -> None:
        self.fsm = BehaviorFsm()
        for behavior in (Behavior.STAND_PREP, Behavior.STAND, Behavior.STEP):
            self.fsm.go(behavior, "test")
        self.queue = StepQueue()
        self.soles = [level_pose(0.0, 0.1, 0.0, 0.0), level_pose(0.0, -0.1, 0.0, 0.0)]
        self.rejections = RejectionCounter()
        self.controller = SimpleNamespace(recovering=False)
        components: Any = SimpleNamespace(
            robot=ROBOT, fsm=self.fsm, step_queue=self.queue, rejections=self.rejections, soles=lambda: self.soles,
            whole_body=self.controller,
        )  # fmt: skip
        self.handler = FootstepPlanHandler(components)
        self.taken: list[Step] = []
        self.walking = False

    def send(self, steps: list[Footstep]) -> str:
        """The reason of a refusal; an empty text: taken."""
        before = (list(self.queue.steps), self.queue.executing, self.queue.state, self.queue.changes)
        reply = self.handler.handle(FootstepPlanRequest(steps=steps), "somebody")
        if not reply.accepted:
            assert reply.reason
            assert (list(self.queue.steps), self.queue.executing, self.queue.state, self.queue.changes) == before
        return reply.reason

    @property
    def status(self) -> StepStatus:
        return self.queue.status(0)

    @property
    def indices(self) -> tuple[int, int, int]:
        status = self.status
        return status.last_performed_step_index, status.executing_step_index, status.first_changeable_step_index

    def go_on(self) -> bool:
        """To the gait's next event: the first or next transfer, or rest. Whether it still walks."""
        queue = self.queue
        if queue.executing is not None:
            step = queue.executing
            self.soles[step.foot] = step.sole
            self.taken.append(step)
            queue.ended(step)
        elif self.walking and not queue.steps:
            queue.rested()
            self.walking = False
            return False
        steps = queue.upcoming(self.soles)
        if steps:
            self.walking = True
            queue.began(steps[0])
        return self.walking

    def finish(self) -> None:
        while self.go_on():
            pass


@pytest.fixture
def bench() -> Bench:
    return Bench()


def ahead(first: int, count: int, length: float = 0.2, x: float | None = None) -> list[Footstep]:
    """Steps straight ahead; step i ends at (i + 1)·length."""
    return [
        footstep(i, i % 2, (length * (i + 1) if x is None else x + length * (i - first + 1)), 0.1 - 0.2 * (i % 2))
        for i in range(first, first + count)
    ]


def footstep(index: int, foot: int, x: float, y: float, yaw: float = 0.0, **more: float) -> Footstep:
    values = {"swing_height": 0.0, "swing_duration": 0.0, "transfer_duration": 0.0} | more
    orientation = np.array((np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)))
    return Footstep(index, foot, np.array((x, y, 0.0)), orientation, **values)


def test_indices_never_go_back(bench: Bench) -> None:
    assert bench.indices == (-1, -1, -1) and not bench.send(ahead(0, 3))
    seen = [bench.indices]
    while bench.go_on():
        seen.append(bench.indices)
    assert seen == [(-1, -1, 0), (-1, 0, 1), (0, 1, 2), (1, 2, 3), (2, -1, 3)]
    assert (bench.status.state, bench.status.reason, bench.indices) == ("finished", "", (2, -1, -1))
    assert bench.queue.take_finished()


@pytest.mark.parametrize("events", [3, 4])
def test_goes_on_behind_the_last_step_while_it_is_taken_and_until_it_is_at_rest(bench: Bench, events: int) -> None:
    assert not bench.send(ahead(0, 3))
    for _ in range(events):
        assert bench.go_on()
    assert "step 0 cannot be changed now; a plan may change from step 3" in bench.send(ahead(0, 2))
    assert "step 4 cannot be changed" in bench.send(ahead(4, 2))
    assert "is of the left foot" in bench.send([footstep(3, 0, 0.7, 0.1)]) and not bench.send(ahead(3, 2))
    bench.finish()
    assert [step.index for step in bench.taken] == [0, 1, 2, 3, 4] and bench.status.state == "finished"


def test_a_change_that_the_robot_has_overtaken_on_its_way_changes_what_comes_behind(bench: Bench) -> None:
    """Its first step is being taken already, and stays where it was; one that moves it comes too late."""
    assert not bench.send(ahead(0, 4))
    for _ in range(3):
        bench.go_on()
    assert bench.status.executing_step_index == 2
    assert "step 2 cannot be changed now" in bench.send(ahead(2, 3, x=0.41))
    assert "step 2 cannot be changed now" in bench.send(ahead(2, 1))
    assert "step 1 cannot be changed now" in bench.send(ahead(1, 4))
    assert not bench.send([*ahead(2, 1), *ahead(3, 2, length=0.1, x=0.6)])
    bench.finish()
    np.testing.assert_allclose([step.sole.position[0] for step in bench.taken], (0.2, 0.4, 0.6, 0.7, 0.8))
    assert (bench.status.state, bench.status.reason) == ("finished", "")


def test_a_stop_brings_the_feet_together(bench: Bench) -> None:
    assert not bench.send([footstep(i, i % 2, 0.2 * (i + 1), 0.1 - 0.2 * (i % 2), yaw=0.1) for i in range(6)])
    bench.go_on()
    bench.go_on()
    assert bench.status.executing_step_index == 1 and not bench.send([])
    assert not bench.send([])  # again: no other
    assert "is ending (stopped by somebody)" in bench.send(ahead(2, 2)) and bench.indices == (0, 1, -1)
    bench.finish()
    assert [step.index for step in bench.taken] == [0, 1, 2]
    left, right = bench.soles
    way = right.rotation.T @ (left.position - right.position)
    np.testing.assert_allclose(way, (0.0, ROBOT.tables.walking.step_width, 0.0), atol=1e-12)
    np.testing.assert_allclose(left.rotation, right.rotation)
    assert (bench.status.state, bench.status.reason) == ("finished", "stopped by somebody")


def test_a_stop_takes_no_step_more_where_the_feet_come_together_anyway(bench: Bench) -> None:
    assert not bench.send([footstep(0, 0, 0.2, 0.1), footstep(1, 1, 0.2, -0.1), *ahead(2, 3, x=0.2)])
    bench.go_on()
    bench.go_on()
    assert not bench.send([])
    bench.finish()
    assert [step.index for step in bench.taken] == [0, 1]


def test_a_stop_of_a_plan_that_has_not_begun_ends_it(bench: Bench) -> None:
    assert not bench.send(ahead(0, 3)) and not bench.send([]) and not bench.go_on()
    assert (bench.status.state, bench.taken) == ("finished", []) and bench.queue.take_finished()


def test_a_plan_that_fails_has_no_steps_left(bench: Bench) -> None:
    assert not bench.send(ahead(0, 3))
    bench.go_on()
    bench.queue.fail("fallen")
    assert (bench.status.state, bench.queue.steps, bench.queue.executing) == ("failed", [], None)


def test_a_stop_during_the_last_step_has_nothing_left_to_stop(bench: Bench) -> None:
    assert not bench.send(ahead(0, 2))
    bench.go_on()
    bench.go_on()
    assert not bench.send([])
    bench.finish()
    assert (bench.status.state, bench.status.reason) == ("finished", "")


def test_no_foot_on_the_other(bench: Bench) -> None:
    """As wide as is allowed, and yet toe on toe: turned inwards."""
    narrow = -0.1 + ROBOT.tables.footsteps.min_width + 0.001  # type: ignore[union-attr]
    assert "step 0 (left): it would stand on the right foot" in bench.send([footstep(0, 0, 0.0, narrow, yaw=-0.5)])
    assert not bench.send([footstep(0, 0, 0.0, narrow)])


def test_a_turn_is_that_of_the_headings_however_the_soles_tilt(bench: Bench) -> None:
    """Up one slope and down another, turned as far as may be, seen from a robot that looks aside."""
    limits = some(ROBOT.tables.footsteps)
    heading, tilt = 1.2, 0.9 * limits.max_tilt

    def sole(yaw: float, pitch: float) -> np.ndarray:
        cy, sy, cp, sp = np.cos(yaw / 2), np.sin(yaw / 2), np.cos(pitch / 2), np.sin(pitch / 2)
        return np.array((cy * cp, -sy * sp, cy * sp, sy * cp))

    bench.soles[1] = level_pose(0.0, 0.0, 0.0, heading)
    place = 0.3 * np.array((-np.sin(heading), np.cos(heading), 0.0))
    for turn, refused in ((0.99 * limits.max_yaw, False), (1.01 * limits.max_yaw, True)):
        asked = Footstep(0, 0, place, sole(heading + turn, tilt), 0.0, 0.0, 0.0)
        assert ("turned from the other foot" in bench.send([asked])) == refused


def test_a_long_step_is_not_a_wide_one() -> None:
    limits = some(ROBOT.tables.footsteps)
    across = 0.99 * min(limits.max_forward, limits.max_width, limits.max_distance)
    reason = Bench().send([footstep(0, 0, across, -0.1 + across)])
    assert reason.startswith("step 0 (left): distance from the other foot 0.")
    assert f"expected 0 to {limits.max_distance:g}" in reason


def test_only_in_step(bench: Bench) -> None:
    bench.fsm.go(Behavior.STAND, "test")
    assert "the behavior is stand" in bench.send(ahead(0, 3)) and "the behavior is stand" in bench.send([])
    assert bench.rejections.total == 2


def test_no_plan_while_the_robot_steps_to_keep_its_balance(bench: Bench) -> None:
    bench.controller.recovering = True
    assert "keep its balance" in bench.send(ahead(0, 2))
    bench.controller.recovering = False
    assert not bench.send(ahead(0, 2))
