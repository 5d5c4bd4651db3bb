"""What the converter, or the Motion Manager, does not take, and why, as the client receives it."""

import numpy as np
from action_msgs.msg import GoalStatus
from vigir_footstep_planning_msgs.msg import ErrorStatus, StepPlan

from harness.instance import RunningInstance
from harness.waiting import wait_until
from tests.integration.footstep_converter.scripted_motion_manager import ScriptedMotionManager, begin
from tests.integration.plan_client import LIMIT, PlanClient, S, plan
from valor.common.messages import FootstepPlanRequest
from valor.common.topics import STATISTICS


def test_without_a_motion_manager_the_error_reports_it(ros_client: PlanClient) -> None:
    def said() -> str:
        status, flags, text = ros_client.outcome(ros_client.send(plan()))
        assert (status, flags) == (GoalStatus.STATUS_ABORTED, S.ERR_CONTROLLER_NOT_READY)
        return text

    wait_until(lambda: "no Motion Manager" in said(), LIMIT, "the one before to be forgotten")


def test_a_broken_plan_is_refused_and_nothing_forwarded(
    instance: RunningInstance, motion: ScriptedMotionManager, ros_client: PlanClient
) -> None:
    statistics = STATISTICS["footstep_converter"].subscriber(instance.node("watch"))
    for _ in range(2):  # the first may have been said before
        newest = statistics.receive(LIMIT)
    assert newest
    before = newest.message.rejected
    elsewhere = plan()
    elsewhere.header.frame_id = "nowhere"
    far = plan()
    far.steps[2].foot.pose.position.x = 5.0
    endless = plan()
    endless.steps = endless.steps * 5000
    later = plan()
    later.header.stamp.sec = 3600
    motion.report("finished")
    motion.wait_until_received()
    wait_until(lambda: motion.step_status and motion.step_status.time > 5_100_000_000, LIMIT, "robot time")
    for broken, flag, error, text in [
        (later, S.ERR_INCONSISTENT_STEP_PLAN, ErrorStatus.ERR_INVALID_PARAMETERS, "s after robot time"),
        (elsewhere, S.ERR_INCONSISTENT_STEP_PLAN, ErrorStatus.ERR_INVALID_PARAMETERS, "frame 'nowhere' is unknown"),
        (far, S.ERR_INVALID_PLAN, ErrorStatus.ERR_INVALID_STEP, "step 2 (left): forward of the other foot"),
        (endless, S.ERR_INVALID_PLAN, ErrorStatus.ERR_INVALID_PARAMETERS, "20000 steps"),
        (StepPlan(), S.ERR_EMPTY_PLAN, ErrorStatus.ERR_INCONSISTENT_REQUEST, "no steps"),
    ]:
        goal = ros_client.send(broken)
        status, flags, said = ros_client.outcome(goal)
        assert (status, flags) == (GoalStatus.STATUS_ABORTED, flag)
        assert goal.last_words.status.error == error
        assert text in said
    assert not motion.requests
    wait_until(lambda: (r := statistics.latest()) and r.message.rejected == before + 5, LIMIT, "the refusals counted")


def test_a_silent_motion_manager_is_requested_to_stop(motion: ScriptedMotionManager, ros_client: PlanClient) -> None:
    motion.silent = True
    goal = ros_client.send(plan())
    status, flags, text = ros_client.outcome(goal)
    assert (status, flags) == (GoalStatus.STATUS_ABORTED, S.ERR_CONTROLLER_NOT_READY)
    assert "no reply of the Motion Manager" in text
    motion.silent = False
    wait_until(lambda: motion.requests and not motion.requests[-1].steps, LIMIT, "the stop")


# Whatever ends a plan before its last step, its client receives what it was.
def test_whatever_ends_the_stepping_ends_the_plan(motion: ScriptedMotionManager, ros_client: PlanClient) -> None:
    for behavior, expected in [
        ("fall", S.ERR_FALLEN | S.EMERGENCY_HALT),
        ("soft_stop", S.EMERGENCY_HALT),
        ("freeze", S.EMERGENCY_HALT),
        ("walk", S.ERR_INVALID_BEHAVIOR_MODE | S.PREMATURE_HALT),
    ]:
        goal = begin(motion, ros_client)
        motion.behavior, motion.reason = behavior, f"there was a reason for {behavior}"
        status, flags, text = ros_client.outcome(goal)
        assert (status, flags) == (GoalStatus.STATUS_ABORTED, expected)
        assert f"entered {behavior!r}: {motion.reason}" in text
        motion.behavior = "stand"
    assert all(request.steps for request in motion.requests), "the Motion Manager has ended it: nothing to stop"


def test_a_canceled_plan_stops(motion: ScriptedMotionManager, ros_client: PlanClient) -> None:
    goal = begin(motion, ros_client)
    ros_client.cancel(goal)
    wait_until(lambda: not motion.requests[-1].steps, LIMIT, "the stop at the Motion Manager")
    assert goal.result is None
    motion.behavior = "stand"
    motion.report("finished", performed=1, reason="stopped")
    status, flags, text = ros_client.outcome(goal)
    assert (status, flags) == (GoalStatus.STATUS_CANCELED, S.PREMATURE_HALT)
    assert "after step 1 of 3: stopped" in text


def test_a_plan_without_steps_stops_the_one_that_runs(motion: ScriptedMotionManager, ros_client: PlanClient) -> None:
    goal = begin(motion, ros_client)
    stop = ros_client.send(StepPlan())
    wait_until(lambda: not motion.requests[-1].steps, LIMIT, "the stop at the Motion Manager")
    refused = ros_client.send(plan(first=2))
    assert "is being stopped" in ros_client.outcome(refused)[2]
    assert goal.result is None
    assert stop.result is None
    motion.report("finished", performed=2, reason="stopped")
    assert ros_client.outcome(goal)[:2] == (GoalStatus.STATUS_ABORTED, S.PREMATURE_HALT)
    assert ros_client.outcome(stop)[:2] == (GoalStatus.STATUS_SUCCEEDED, S.PREMATURE_HALT)
    assert [len(request.steps) for request in motion.requests] == [4, 0]


def test_stopping_the_converter_stops_the_plan_and_notifies_the_client(
    instance: RunningInstance, motion: ScriptedMotionManager, ros_client: PlanClient
) -> None:
    goal = begin(motion, ros_client)
    try:
        assert instance.stop("footstep_converter") == 0
        assert not motion.requests[-1].steps
        status, flags, text = ros_client.outcome(goal)
        assert (status, flags) == (GoalStatus.STATUS_ABORTED, S.ERR_CONTROLLER_NOT_READY | S.PREMATURE_HALT)
        assert "stopping" in text
    finally:
        instance.start("footstep_converter", wait=True)
        ros_client.wait_for_server()


# A plan that comes while another runs.
def test_an_update_takes_over_from_where_the_robot_is(motion: ScriptedMotionManager, ros_client: PlanClient) -> None:
    """The planner's second plan begins with a step that has been taken, and everything in it lies 5 cm to the left."""
    goal = begin(motion, ros_client)
    gap = ros_client.send(plan(first=5))
    assert ros_client.outcome(gap)[1] == S.ERR_INVALID_INCONSISTENT_INDICES
    shifted = plan(first=1, count=7)
    for step in shifted.steps:
        step.foot.pose.position.y += 0.05
    update = ros_client.send(shifted)
    status, flags, text = ros_client.outcome(goal)
    assert (status, flags) == (GoalStatus.STATUS_ABORTED, S.UPDATED_STEP_PLAN)
    assert "from step 2 on" in text
    sent = motion.requests[1].steps
    assert [step.step_index for step in sent] == [2, 3, 4, 5, 6, 7]
    for step, straight in zip(sent, plan(first=2, count=6).steps, strict=True):
        p = straight.foot.pose.position
        np.testing.assert_allclose(step.position_in_odom, [p.x, p.y, p.z], atol=1e-9)
    motion.report("executing", performed=6, executing=7, changeable=8)
    wait_until(lambda: any(f.currently_executing_step_index == 7 for f in update.feedback), LIMIT, "the last step")
    seen = next(f for f in reversed(update.feedback) if f.currently_executing_step_index == 7)
    assert [step.step_index for step in seen.feedback.steps] == list(range(8))
    assert {step.header.frame_id for step in seen.feedback.steps} == {"odom"}
    more = ros_client.send(plan(first=8, count=2))  # behind the last step, while it is taken
    assert ros_client.outcome(update)[1] == S.UPDATED_STEP_PLAN
    motion.report("finished", performed=9)
    assert ros_client.outcome(more)[:2] == (GoalStatus.STATUS_SUCCEEDED, S.REACHED_GOAL)
    assert len(motion.requests) == 3
    for received in (goal, update, more):
        indices = [
            (f.last_performed_step_index, f.currently_executing_step_index, f.first_changeable_step_index)
            for f in received.feedback
            if f.controller_state != f.READY
        ]
        assert all(performed <= executing < changeable for performed, executing, changeable in indices)
        assert indices == sorted(indices)


def test_an_update_that_the_robot_overtakes_on_its_way_leaves_in_place_what_has_begun(
    motion: ScriptedMotionManager, ros_client: PlanClient
) -> None:
    """By which the Motion Manager knows that the rest can be taken."""
    goal = begin(motion, ros_client)

    def overtaken(request: FootstepPlanRequest) -> tuple[bool, str]:
        motion.report("executing", performed=1, executing=2, queue=3, changeable=3)
        motion.publish()
        return True, ""

    motion.accepts = overtaken
    shifted = plan(first=2, count=4)
    for step in shifted.steps:
        step.foot.pose.position.y += 0.05
    update = ros_client.send(shifted)
    assert ros_client.outcome(goal)[1] == S.UPDATED_STEP_PLAN
    planned, sent = motion.requests[0].steps[2], motion.requests[1].steps[0]
    np.testing.assert_array_equal(sent.position_in_odom, planned.position_in_odom)
    np.testing.assert_array_equal(sent.orientation_in_odom, planned.orientation_in_odom)
    motion.report("finished", performed=5)
    assert ros_client.outcome(update)[:2] == (GoalStatus.STATUS_SUCCEEDED, S.REACHED_GOAL)


def test_a_refused_update_leaves_the_plan_running(motion: ScriptedMotionManager, ros_client: PlanClient) -> None:
    goal = begin(motion, ros_client)
    motion.accepts = lambda request: (False, "too late for step 2")
    update = ros_client.send(plan(first=2, count=6))
    assert ros_client.outcome(update)[2] == "too late for step 2"
    motion.report("finished", performed=3)
    assert ros_client.outcome(goal)[:2] == (GoalStatus.STATUS_SUCCEEDED, S.REACHED_GOAL)
