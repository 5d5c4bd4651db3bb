"""However the Motion Manager behaves, a plan ends, and ends with the truth."""

from __future__ import annotations

from itertools import pairwise

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from vigir_footstep_planning_msgs.msg import FootstepExecutionStatus

from valor.common.messages import StepStatus
from valor.common.poses import Pose
from valor.footstep_converter.execution import SETTLE, SILENCE, START, STOP, End, Execution, refusal
from valor.footstep_converter.plan import PlannedStep

S = FootstepExecutionStatus


def plan(first: int, last: int) -> list[PlannedStep]:
    return [PlannedStep(i, i % 2, Pose(), 0.0, 0.0, 0.0) for i in range(first, last + 1)]


def hear(execution: Execution, behavior: str, reason: str, now: float) -> None:
    """A behavior, heard when it is so: robot time goes by as the clock does."""
    execution.heard_behavior(behavior, reason, now, round(now * 1e9))


def changed(word: StepStatus, **values: int) -> StepStatus:
    """A copy with other values."""
    return msgspec.structs.replace(word, **values)


def status(state: str, performed: int = -1, reason: str = "", changeable: int = -1) -> StepStatus:
    return StepStatus(
        time=0,
        state=state,
        reason=reason,
        queue_size=0,
        last_performed_step_index=performed,
        executing_step_index=-1,
        first_changeable_step_index=changeable,
    )


@pytest.fixture
def execution() -> Execution:
    """A plan of steps 0 to 3, accepted at 0 s."""
    return Execution(plan(0, 3), 0.0)


def test_finished_with_the_last_step_succeeds(execution: Execution) -> None:
    hear(execution, "step", "", 0.1)
    execution.heard_status(status("executing"), 0.1)
    execution.heard_status(status("finished", 3), 3.0)
    assert execution.outcome is not None
    assert (execution.outcome.end, execution.outcome.status) == (End.SUCCEEDED, S.REACHED_GOAL)


def test_words_about_the_plan_before_are_not_about_this_one(execution: Execution) -> None:
    execution.heard_status(status("finished", 3), 0.1)
    execution.heard_status(status("failed", 1), 0.2)
    assert execution.outcome is None
    assert execution.status is None


@pytest.mark.parametrize("state", ["finished", "failed", "idle"])
def test_an_end_before_the_last_step_is_a_failure_with_its_cause(execution: Execution, state: str) -> None:
    execution.heard_status(status("executing"), 0.1)
    execution.heard_status(status(state, 1, "the swing foot hit something"), 1.0)
    assert execution.outcome is not None
    assert execution.outcome.end is End.ABORTED
    assert execution.outcome.status & S.PREMATURE_HALT
    assert "after step 1 of 3: the swing foot hit something" in execution.outcome.text


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
    execution.heard_status(status("executing"), 0.1)
    hear(execution, behavior, "because", 0.5)
    assert execution.outcome is not None
    assert (execution.outcome.end, execution.outcome.status) == (End.ABORTED, flags)
    assert execution.outcome.text == f"the Motion Manager went to {behavior!r}: because"


def test_the_return_to_stand_waits_for_the_last_word(execution: Execution) -> None:
    hear(execution, "step_manipulate", "", 0.1)
    execution.heard_status(status("executing"), 0.1)
    hear(execution, "stand", "plan done", 1.0)
    execution.passed(1.0 + 0.9 * SETTLE)
    assert execution.outcome is None
    execution.heard_status(status("finished", 3), 1.0 + 0.95 * SETTLE)
    assert execution.outcome is not None
    assert execution.outcome.end is End.SUCCEEDED


def test_the_return_to_stand_without_a_word_is_a_failure(execution: Execution) -> None:
    hear(execution, "step", "", 0.1)
    execution.heard_status(status("executing"), 0.1)
    hear(execution, "stand", "commanded", 1.0)
    hear(execution, "stand", "commanded", 1.0 + 1.1 * SETTLE)
    execution.passed(1.0 + 1.1 * SETTLE)
    assert execution.outcome is not None
    assert execution.outcome.status & S.ERR_INVALID_BEHAVIOR_MODE
    assert "went to 'stand' before the plan's end: commanded" in execution.outcome.text


def test_a_change_to_stand_in_mid_plan_is_told_once_the_robot_has_come_to_rest(execution: Execution) -> None:
    """The Motion Manager takes its time to finish the step that is being taken, and says so meanwhile."""
    hear(execution, "step", "", 0.1)
    execution.heard_status(status("executing", 0), 0.1)
    hear(execution, "stand", "requested by valor_ros_controller", 1.0)
    for i in range(20):
        time = round((1.0 + 0.5 * (i + 1) * SETTLE) * 1e9)
        execution.heard_status(changed(status("executing", 0), time=time), 1.0 + 0.5 * i * SETTLE)
        execution.passed(1.0 + 0.5 * i * SETTLE)
        assert execution.outcome is None
    execution.heard_status(status("finished", 1, "stand: requested by valor_ros_controller"), 12.0)
    assert execution.outcome is not None
    assert execution.outcome.status == S.ERR_INVALID_BEHAVIOR_MODE | S.PREMATURE_HALT
    assert "after step 1 of 3: stand: requested by" in execution.outcome.text


def at(seconds: float) -> StepStatus:
    """A word of steps being taken."""
    return changed(status("executing", 0), time=round(seconds * 1e9))


@pytest.mark.parametrize(("stood", "flags"), [(1.05, S.ERR_INVALID_BEHAVIOR_MODE), (0.95, S.ERR_UNKNOWN)])
def test_a_change_to_stand_is_known_where_step_itself_went_unseen(
    execution: Execution, stood: float, flags: int
) -> None:
    """By a word of steps being taken; but what was said of Stand before that word is old."""
    execution.heard_status(at(1.0), 1.1)
    execution.heard_behavior("stand", "requested by somebody", 1.1, round(stood * 1e9))
    execution.heard_status(at(1.1), 1.2)
    execution.heard_status(status("finished", 1, "stopped"), 2.0)
    assert execution.outcome is not None
    assert execution.outcome.status == flags | S.PREMATURE_HALT


def test_a_plan_that_is_told_to_end_did_not_reach_its_goal_however_many_steps_it_took(execution: Execution) -> None:
    execution.heard_status(status("executing", 1), 0.1)
    execution.heard_status(status("finished", 3, "stopped by somebody"), 1.0)
    assert execution.outcome is not None
    assert execution.outcome.end is End.ABORTED


indices = st.integers(-1, 9)


@given(st.lists(st.tuples(indices, indices, indices), max_size=20))
def test_no_index_of_the_progress_goes_back(words: list[tuple[int, int, int]]) -> None:
    execution = Execution(plan(0, 9), 0.0)
    seen = [execution.progress]
    for performed, executing, changeable in words:
        execution.heard_status(
            changed(status("executing", performed, changeable=changeable), executing_step_index=executing), 0.1
        )
        seen.append(execution.progress)
    for before, after in pairwise(seen):
        assert before.performed <= after.performed
        assert before.executing <= after.executing
        assert before.changeable <= after.changeable
        assert after.performed <= after.executing < after.changeable


def test_standing_before_the_first_step_is_no_return(execution: Execution) -> None:
    hear(execution, "stand", "", 0.1)
    execution.passed(0.1 + 1.1 * SETTLE)
    assert execution.outcome is None


def test_silence_is_named(execution: Execution) -> None:
    execution.heard_status(status("executing"), 0.5)
    execution.passed(0.5 + 0.9 * SILENCE)
    assert execution.outcome is None
    execution.passed(0.5 + 1.1 * SILENCE)
    assert execution.outcome is not None
    assert execution.outcome.status & S.ERR_CONTROLLER_NOT_READY
    assert execution.outcome.unconfirmed
    assert "no word of the Motion Manager" in execution.outcome.text


def test_accepted_but_never_begun_is_named(execution: Execution) -> None:
    hear(execution, "stand", "", 0.1)
    hear(execution, "stand", "", 0.1 + 1.1 * START)
    execution.passed(0.1 + 1.1 * START)
    assert execution.outcome is not None
    assert "reports no step" in execution.outcome.text


def test_a_stop_ends_canceled_and_says_where(execution: Execution) -> None:
    execution.heard_status(status("executing"), 0.1)
    execution.stop_asked(0.5)
    execution.heard_status(status("finished", 1, "stopped"), 1.0)
    assert execution.outcome is not None
    assert (execution.outcome.end, execution.outcome.status) == (End.CANCELED, S.PREMATURE_HALT)
    assert "after step 1 of 3: stopped" in execution.outcome.text


def test_a_stop_that_comes_too_late_still_reached_the_goal(execution: Execution) -> None:
    execution.heard_status(status("executing"), 0.1)
    execution.stop_asked(0.5)
    execution.heard_status(status("finished", 3), 1.0)
    assert execution.outcome is not None
    assert execution.outcome.end is End.SUCCEEDED


def test_a_stop_never_confirmed_is_named(execution: Execution) -> None:
    hear(execution, "step", "", 0.1)
    execution.heard_status(status("executing"), 0.1)
    execution.stop_asked(0.5)
    hear(execution, "step", "", 0.6)
    hear(execution, "step", "", 0.6 + 1.1 * STOP)
    execution.passed(0.6 + 1.1 * STOP)
    assert execution.outcome is not None
    assert execution.outcome.end is End.ABORTED
    assert execution.outcome.unconfirmed


def test_a_robot_whose_time_goes_by_slowly_is_given_its_time(execution: Execution) -> None:
    """A simulation twenty times as slow as the wall: steps begin and feet come down in its time."""
    now, time = 0.1, 99_000_000_000
    while now < 5.0 * START:
        execution.heard_behavior("stand", "", now, time)
        execution.passed(now)
        assert execution.outcome is None
        now, time = now + 1.0, time + 50_000_000
    execution.stop_asked(now)
    until = now + 5.0 * STOP
    while now < until:
        execution.heard_behavior("step", "", now, time)
        execution.heard_status(changed(status("executing"), time=time), now)
        execution.passed(now)
        assert execution.outcome is None
        now, time = now + 1.0, time + 50_000_000
    execution.heard_status(status("finished", 1, "stopped"), now)
    assert execution.outcome is not None
    assert execution.outcome.end is End.CANCELED


def test_an_update_moves_the_goal(execution: Execution) -> None:
    execution.heard_status(status("executing", changeable=2), 0.1)
    execution.update(plan(2, 7))
    assert [step.index for step in execution.plan] == list(range(8))
    execution.heard_status(status("executing", 3), 0.3)
    assert execution.outcome is None
    execution.heard_status(status("finished", 7), 0.4)
    assert execution.outcome is not None
    assert execution.outcome.end is End.SUCCEEDED


def test_a_refusal_carries_the_motion_managers_own_words() -> None:
    for behavior, flag in [
        ("step", S.ERR_CONTROLLER_NOT_READY),
        ("stand", S.ERR_INVALID_BEHAVIOR_MODE),
        ("stand_manipulate", S.ERR_INVALID_BEHAVIOR_MODE),
        ("walk", S.ERR_INVALID_BEHAVIOR_MODE),
        ("soft_stop", S.ERR_INVALID_BEHAVIOR_MODE),
        ("fall", S.ERR_FALLEN | S.ERR_INVALID_BEHAVIOR_MODE),
    ]:
        outcome = refusal(behavior, "stepping is not built yet")
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
def test_success_is_claimed_only_of_a_finished_plan_and_no_outcome_changes(
    story: list[tuple[tuple[str, str, int], float]],
) -> None:
    execution = Execution(plan(0, 3), 0.0)
    now, executed, finished, outcome = 0.0, False, False, None
    for (kind, word, index), wait in story:
        now += wait
        execution.passed(now)
        if execution.outcome is None:
            executed |= (kind, word) == ("status", "executing")
            finished |= executed and (kind, word, index) == ("status", "finished", 3)
        if kind == "status":
            execution.heard_status(status(word, index), now)
        elif kind == "behavior":
            hear(execution, word, "", now)
        else:
            execution.stop_asked(now)
        if outcome is not None:
            assert execution.outcome is outcome
        outcome = execution.outcome
        assert (outcome is not None and outcome.end is End.SUCCEEDED) == finished
    execution.passed(now + 1.01 * max(SILENCE, START, STOP, SETTLE))
    assert execution.outcome is not None
