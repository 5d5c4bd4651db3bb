"""What the converter, or the Motion Manager, does not take, and why, as the client hears it."""

from __future__ import annotations

import time

from action_msgs.msg import GoalStatus
from vigir_footstep_planning_msgs.msg import ErrorStatus, StepPlan

from harness.instance import RunningInstance
from harness.waiting import wait_until
from tests.integration.footstep_converter.planner import LIMIT, Client, S, plan
from tests.integration.footstep_converter.scripted_motion_manager import ScriptedMotionManager
from valor.common.topics import STATISTICS


def test_without_a_motion_manager_the_error_says_so(ros_client: Client) -> None:
    def said() -> str:
        status, flags, text = ros_client.outcome(ros_client.send(plan()))
        assert (status, flags) == (GoalStatus.STATUS_ABORTED, S.ERR_CONTROLLER_NOT_READY)
        return text

    wait_until(lambda: "no Motion Manager" in said(), LIMIT, "the one before to be forgotten")


def test_a_refusal_is_passed_on_word_for_word(motion: ScriptedMotionManager, ros_client: Client) -> None:
    motion.behavior, motion.accepts = "step", lambda request: (False, "stepping is not available yet")
    goal = ros_client.send(plan())
    assert ros_client.outcome(goal) == (
        GoalStatus.STATUS_ABORTED,
        S.ERR_CONTROLLER_NOT_READY,
        "stepping is not available yet",
    )
    for behavior in ("stand", "walk"):  # one code for the wrong mode, wherever the robot stands
        motion.behavior, motion.accepts = behavior, lambda request: (False, "ask for step first")
        status, flags, text = ros_client.outcome(ros_client.send(plan()))
        assert (status, flags, text) == (
            GoalStatus.STATUS_ABORTED,
            S.ERR_INVALID_BEHAVIOR_MODE,
            "ask for step first",
        )
    motion.behavior, motion.accepts = "fall", lambda request: (False, "the robot has fallen")
    goal = ros_client.send(plan())
    status, flags, text = ros_client.outcome(goal)
    assert (status, text) == (GoalStatus.STATUS_ABORTED, "the robot has fallen")
    assert flags & S.ERR_FALLEN
    assert all(request.steps for request in motion.requests)


def test_a_broken_plan_is_refused_and_nothing_forwarded(
    instance: RunningInstance, motion: ScriptedMotionManager, ros_client: Client
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
    for broken, flag, error, text in [
        (elsewhere, S.ERR_INCONSISTENT_STEP_PLAN, ErrorStatus.ERR_INVALID_PARAMETERS, "frame 'nowhere' is not known"),
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
    wait_until(lambda: (r := statistics.latest()) and r.message.rejected == before + 4, LIMIT, "the refusals counted")


def test_a_plan_of_any_length_is_refused_quickly(motion: ScriptedMotionManager, ros_client: Client) -> None:
    """Its steps are taken off the wire and not looked at: longer by ten, hardly longer by more than ten."""

    def refused(count: int) -> float:
        endless = plan(count=count)
        began = time.monotonic()
        assert ros_client.outcome(ros_client.send(endless))[1] == S.ERR_INVALID_PLAN
        return time.monotonic() - began

    short, long = (min(refused(count) for _ in range(2)) for count in (500, 5_000))
    assert long < 15.0 * short + 1.0, f"{short:.2f} s for 500 steps, {long:.2f} s for 5000"


def test_a_silent_motion_manager_is_told_to_stop(motion: ScriptedMotionManager, ros_client: Client) -> None:
    motion.silent = True
    goal = ros_client.send(plan())
    status, flags, text = ros_client.outcome(goal)
    assert (status, flags) == (GoalStatus.STATUS_ABORTED, S.ERR_CONTROLLER_NOT_READY)
    assert "did not answer" in text
    motion.silent = False
    wait_until(lambda: motion.requests and not motion.requests[-1].steps, LIMIT, "the stop")
