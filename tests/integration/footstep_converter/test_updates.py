"""A plan that comes while another runs."""

from __future__ import annotations

import numpy as np
from action_msgs.msg import GoalStatus

from harness.waiting import wait_until
from tests.integration.footstep_converter.planner import LIMIT, Client, S, plan
from tests.integration.footstep_converter.scripted_motion_manager import ScriptedMotionManager, begin
from valor.common.messages import FootstepPlanRequest


def test_an_update_takes_over_from_where_the_robot_is(motion: ScriptedMotionManager, ros_client: Client) -> None:
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
    motion.says("executing", performed=6, executing=7, changeable=8)
    wait_until(lambda: any(f.currently_executing_step_index == 7 for f in update.feedback), LIMIT, "the last step")
    seen = next(f for f in reversed(update.feedback) if f.currently_executing_step_index == 7)
    assert [step.step_index for step in seen.feedback.steps] == list(range(8))
    assert {step.header.frame_id for step in seen.feedback.steps} == {"odom"}
    more = ros_client.send(plan(first=8, count=2))  # behind the last step, while it is taken
    assert ros_client.outcome(update)[1] == S.UPDATED_STEP_PLAN
    motion.says("finished", performed=9)
    assert ros_client.outcome(more)[:2] == (GoalStatus.STATUS_SUCCEEDED, S.REACHED_GOAL)
    assert len(motion.requests) == 3
    for heard in (goal, update, more):
        indices = [
            (f.last_performed_step_index, f.currently_executing_step_index, f.first_changeable_step_index)
            for f in heard.feedback
            if f.controller_state != f.READY
        ]
        assert all(performed <= executing < changeable for performed, executing, changeable in indices)
        assert indices == sorted(indices)


def test_an_update_that_the_robot_overtakes_on_its_way_leaves_in_place_what_has_begun(
    motion: ScriptedMotionManager, ros_client: Client
) -> None:
    """By which the Motion Manager knows that the rest can be taken."""
    goal = begin(motion, ros_client)

    def overtaken(request: FootstepPlanRequest) -> tuple[bool, str]:
        motion.says("executing", performed=1, executing=2, queue=3, changeable=3)
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
    motion.says("finished", performed=5)
    assert ros_client.outcome(update)[:2] == (GoalStatus.STATUS_SUCCEEDED, S.REACHED_GOAL)


def test_a_refused_update_leaves_the_plan_running(motion: ScriptedMotionManager, ros_client: Client) -> None:
    goal = begin(motion, ros_client)
    motion.accepts = lambda request: (False, "too late for step 2")
    update = ros_client.send(plan(first=2, count=6))
    assert ros_client.outcome(update)[2] == "too late for step 2"
    motion.says("finished", performed=3)
    assert ros_client.outcome(goal)[:2] == (GoalStatus.STATUS_SUCCEEDED, S.REACHED_GOAL)
