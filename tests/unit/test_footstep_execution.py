"""However the Motion Manager behaves, a plan ends, and ends with the truth."""

from collections.abc import Callable
from itertools import pairwise

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from vigir_footstep_planning_msgs.msg import FootstepExecutionStatus

from valor.common.messages import StepStatus
from valor.common.poses import Pose
from valor.footstep_converter.execution import SETTLE, SILENCE, START, STOP, End, Execution, rejected
from valor.footstep_converter.plan import PlannedStep

S = FootstepExecutionStatus


def plan(first: int, last: int) -> list[PlannedStep]:
    return [PlannedStep(i, i % 2, Pose(), 0.0, 0.0, 0.0) for i in range(first, last + 1)]


def hear(execution: Execution, behavior: str, reason: str, now: float) -> None:
    """A behavior, received when it is so: robot time goes by as the clock does."""
    execution.add_behavior(behavior, reason, now, round(now * 1e9))


def changed(word: StepStatus, **values: int) -> StepStatus:
    return msgspec.structs.replace(word, **values)


def status(state: str, performed: int = -1, reason: str = "", changeable: int = -1) -> StepStatus:
    return StepStatus(
        time=0, state=state, reason=reason, queue_size=0, last_performed_step_index=performed,
        executing_step_index=-1, first_changeable_step_index=changeable,
    )  # fmt: skip


@pytest.fixture
def execution() -> Execution:
    """A plan of steps 0 to 3, accepted at 0 s."""
    return Execution(plan(0, 3), 0.0)


@pytest.mark.parametrize(("state", "done"), [("finished", 1), ("failed", 1), ("idle", 1), ("finished", 3)])
def test_an_end_with_a_cause_is_a_failure_after_any_step(execution: Execution, state: str, done: int) -> None:
    execution.add_status(status("executing"), 0.1)
    execution.add_status(status(state, done, "the swing foot hit something"), 1.0)
    assert execution.outcome is not None and execution.outcome.end is End.ABORTED
    assert execution.outcome.status & S.PREMATURE_HALT
    assert f"after step {done} of 3: the swing foot hit something" in execution.outcome.text


@pytest.mark.parametrize(
    ("behavior", "flags"),
    [
        ("fall", S.ERR_FALLEN | S.EMERGENCY_HALT),
        ("soft_stop", S.EMERGENCY_HALT),
        ("freeze", S.EMERGENCY_HALT),
        ("idle", S.ERR_INVALID_BEHAVIOR_MODE | S.PREMATURE_HALT),
        ("walk", S.ERR_INVALID_BEHAVIOR_MODE | S.PREMATURE_HALT),
    ],
)
def test_a_behavior_that_does_not_step_ends_the_plan(execution: Execution, behavior: str, flags: int) -> None:
    hear(execution, "step", "", 0.1)
    execution.add_status(status("executing"), 0.1)
    hear(execution, behavior, "because", 0.5)
    assert execution.outcome is not None and (execution.outcome.end, execution.outcome.status) == (End.ABORTED, flags)
    assert execution.outcome.text == f"the Motion Manager entered {behavior!r}: because"


def test_a_change_to_stand_in_mid_plan_is_reported_once_the_robot_has_come_to_rest(execution: Execution) -> None:
    """The Motion Manager takes its time to finish the step that is being taken, and reports so meanwhile."""
    hear(execution, "step", "", 0.1)
    execution.add_status(status("executing", 0), 0.1)
    hear(execution, "stand", "requested by valor_ros_controller", 1.0)
    for i in range(20):
        time = round((1.0 + 0.5 * (i + 1) * SETTLE) * 1e9)
        execution.add_status(changed(status("executing", 0), time=time), 1.0 + 0.5 * i * SETTLE)
        execution.check_timeouts(1.0 + 0.5 * i * SETTLE)
        assert execution.outcome is None
    execution.add_status(status("finished", 1, "stand: requested by valor_ros_controller"), 12.0)
    assert execution.outcome is not None and execution.outcome.status == S.ERR_INVALID_BEHAVIOR_MODE | S.PREMATURE_HALT
    assert "after step 1 of 3: stand: requested by" in execution.outcome.text


def at(seconds: float) -> StepStatus:
    return changed(status("executing", 0), time=round(seconds * 1e9))


@pytest.mark.parametrize(("stood", "flags"), [(1.05, S.ERR_INVALID_BEHAVIOR_MODE), (0.95, S.ERR_UNKNOWN)])
def test_a_change_to_stand_is_known_though_step_went_unseen(execution: Execution, stood: float, flags: int) -> None:
    """By a word of steps being taken; but what was said of Stand before that word is old."""
    execution.add_status(at(1.0), 1.1)
    execution.add_behavior("stand", "requested by somebody", 1.1, round(stood * 1e9))
    execution.add_status(at(1.1), 1.2)
    execution.add_status(status("finished", 1, "stopped"), 2.0)
    assert execution.outcome is not None and execution.outcome.status == flags | S.PREMATURE_HALT


indices = st.integers(-1, 9)


@given(st.lists(st.tuples(indices, indices, indices), max_size=20))
def test_no_index_of_the_progress_goes_back(words: list[tuple[int, int, int]]) -> None:
    execution = Execution(plan(0, 9), 0.0)
    seen = [execution.progress]
    for performed, executing, changeable in words:
        execution.add_status(
            changed(status("executing", performed, changeable=changeable), executing_step_index=executing), 0.1
        )
        seen.append(execution.progress)
    for before, after in pairwise(seen):
        assert before.performed <= after.performed and before.executing <= after.executing
        assert before.changeable <= after.changeable and after.performed <= after.executing < after.changeable


def stand(execution: Execution, until: float) -> None:
    hear(execution, "stand", "commanded", 1.0)
    hear(execution, "stand", "commanded", until)


def step_then_stand(execution: Execution, until: float) -> None:
    hear(execution, "step", "", 0.1)
    execution.add_status(status("executing"), 0.1)
    stand(execution, until)


def fall_silent(execution: Execution, _: float) -> None:
    execution.add_status(status("executing"), 1.0)


def stop(execution: Execution, until: float) -> None:
    hear(execution, "step", "", 0.1)
    execution.add_status(status("executing"), 0.1)
    execution.request_stop(0.9)
    hear(execution, "step", "", 1.0)
    hear(execution, "step", "", until)


@pytest.mark.parametrize(
    ("story", "limit", "flags", "text"),
    [
        (step_then_stand, SETTLE, S.ERR_INVALID_BEHAVIOR_MODE, "entered 'stand' before the plan's end: commanded"),
        (fall_silent, SILENCE, S.ERR_CONTROLLER_NOT_READY, "no message of the Motion Manager"),
        (stand, START, S.ERR_UNKNOWN, "reports no step"),
        (stop, STOP, S.ERR_UNKNOWN, "did not confirm the stop"),
    ],
)
def test_what_does_not_come_is_named_and_the_end_is_not_confirmed(
    execution: Execution, story: Callable[[Execution, float], None], limit: float, flags: int, text: str
) -> None:
    story(execution, 1.0 + 0.9 * limit)
    execution.check_timeouts(1.0 + 0.9 * limit)
    assert execution.outcome is None
    if story is not fall_silent:
        story(execution, 1.0 + 1.1 * limit)
    execution.check_timeouts(1.0 + 1.1 * limit)
    outcome = execution.outcome
    assert outcome is not None and outcome.end is End.ABORTED and outcome.unconfirmed
    assert outcome.status == flags | S.PREMATURE_HALT and text in outcome.text


@pytest.mark.parametrize(
    ("performed", "reason", "end", "flags"),
    [(1, "stopped", End.CANCELED, S.PREMATURE_HALT), (3, "", End.SUCCEEDED, S.REACHED_GOAL)],
)
def test_a_stop_ends_canceled_or_too_late(
    execution: Execution, performed: int, reason: str, end: End, flags: int
) -> None:
    execution.add_status(status("executing"), 0.1)
    execution.request_stop(0.5)
    execution.add_status(status("finished", performed, reason), 1.0)
    assert execution.outcome is not None and (execution.outcome.end, execution.outcome.status) == (end, flags)
    assert end is End.SUCCEEDED or "after step 1 of 3: stopped" in execution.outcome.text


def test_a_robot_whose_time_goes_by_slowly_is_given_its_time(execution: Execution) -> None:
    """A simulation twenty times as slow as the wall: steps begin and feet come down in its time."""
    now, time = 0.1, 99_000_000_000
    while now < 5.0 * START:
        execution.add_behavior("stand", "", now, time)
        execution.check_timeouts(now)
        assert execution.outcome is None
        now, time = now + 1.0, time + 50_000_000
    execution.request_stop(now)
    until = now + 5.0 * STOP
    while now < until:
        execution.add_behavior("step", "", now, time)
        execution.add_status(changed(status("executing"), time=time), now)
        execution.check_timeouts(now)
        assert execution.outcome is None
        now, time = now + 1.0, time + 50_000_000
    execution.add_status(status("finished", 1, "stopped"), now)
    assert execution.outcome is not None and execution.outcome.end is End.CANCELED


def test_an_update_moves_the_goal(execution: Execution) -> None:
    execution.add_status(status("executing", changeable=2), 0.1)
    execution.update(plan(2, 7))
    assert [step.index for step in execution.plan] == list(range(8))
    execution.add_status(status("executing", 3), 0.3)
    assert execution.outcome is None
    execution.add_status(status("finished", 7), 0.4)
    assert execution.outcome is not None and execution.outcome.end is End.SUCCEEDED


def test_a_refusal_carries_the_motion_managers_own_words() -> None:
    for behavior, flag in [
        ("step", S.ERR_CONTROLLER_NOT_READY),
        ("stand", S.ERR_INVALID_BEHAVIOR_MODE),
        ("fall", S.ERR_FALLEN | S.ERR_INVALID_BEHAVIOR_MODE),
    ]:
        outcome = rejected(behavior, "stepping is not built yet")
        assert (outcome.status, outcome.text) == (flag, "stepping is not built yet")


words = st.one_of(
    st.tuples(st.just("status"), st.sampled_from(["idle", "executing", "finished", "failed"]), st.integers(-1, 4)),
    st.tuples(
        st.just("behavior"),
        st.sampled_from(["idle", "stand", "step", "step_manipulate", "walk", "soft_stop", "fall"]),
        st.just(0),
    ),
    st.tuples(st.just("stop"), st.just(""), st.just(0)),
)


@given(st.lists(st.tuples(words, st.floats(0.0, 1.0)), max_size=40))
def test_success_is_of_a_finished_plan_and_no_outcome_changes(story: list[tuple[tuple[str, str, int], float]]) -> None:
    execution = Execution(plan(0, 3), 0.0)
    now, executed, finished, outcome = 0.0, False, False, None
    for (kind, word, index), wait in story:
        now += wait
        execution.check_timeouts(now)
        if execution.outcome is None:
            executed |= (kind, word) == ("status", "executing")
            finished |= executed and (kind, word, index) == ("status", "finished", 3)
        if kind == "status":
            execution.add_status(status(word, index), now)
        elif kind == "behavior":
            hear(execution, word, "", now)
        else:
            execution.request_stop(now)
        if outcome is not None:
            assert execution.outcome is outcome
        outcome = execution.outcome
        assert (outcome is not None and outcome.end is End.SUCCEEDED) == finished
    execution.check_timeouts(now + 1.01 * max(SILENCE, START, STOP, SETTLE))
    assert execution.outcome is not None
