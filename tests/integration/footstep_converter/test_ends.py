"""Whatever ends a plan before its last step, its client hears what it was."""

from __future__ import annotations

from action_msgs.msg import GoalStatus
from vigir_footstep_planning_msgs.msg import StepPlan

from harness.instance import RunningInstance
from harness.waiting import wait_until
from tests.integration.footstep_converter.planner import LIMIT, Client, S, plan
from tests.integration.footstep_converter.scripted_motion_manager import ScriptedMotionManager, begin


def test_whatever_ends_the_stepping_ends_the_plan(motion: ScriptedMotionManager, ros_client: Client) -> None:
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
        assert f"went to {behavior!r}: {motion.reason}" in text
        motion.behavior = "stand"
    assert all(request.steps for request in motion.requests), "the Motion Manager has ended it: nothing to stop"


def test_a_change_of_mode_to_stand_ends_the_plan_once_the_robot_stands(
    motion: ScriptedMotionManager, ros_client: Client
) -> None:
    goal = begin(motion, ros_client)
    motion.behavior, motion.reason = "stand", "requested by valor_ros_controller"
    heard = len(goal.feedback)
    wait_until(lambda: len(goal.feedback) > heard + 3, LIMIT, "feedback while the robot finishes its step")
    assert goal.result is None
    motion.says("finished", performed=1, reason=f"stand: {motion.reason}", time=6_000_000_000)
    status, flags, text = ros_client.outcome(goal)
    assert (status, flags) == (GoalStatus.STATUS_ABORTED, S.ERR_INVALID_BEHAVIOR_MODE | S.PREMATURE_HALT)
    assert motion.reason in text


def test_the_loss_of_the_motion_manager_ends_the_plan(motion: ScriptedMotionManager, ros_client: Client) -> None:
    goal = begin(motion, ros_client)
    motion.silent = True
    status, flags, text = ros_client.outcome(goal)
    assert (status, flags) == (GoalStatus.STATUS_ABORTED, S.ERR_CONTROLLER_NOT_READY | S.PREMATURE_HALT)
    assert "no word of the Motion Manager" in text
    motion.silent = False
    wait_until(lambda: not motion.requests[-1].steps, LIMIT, "the stop of what nobody follows")


def test_a_canceled_plan_stops(motion: ScriptedMotionManager, ros_client: Client) -> None:
    goal = begin(motion, ros_client)
    ros_client.cancel(goal)
    wait_until(lambda: not motion.requests[-1].steps, LIMIT, "the stop at the Motion Manager")
    assert goal.result is None
    motion.behavior = "stand"
    motion.says("finished", performed=1, reason="stopped")
    status, flags, text = ros_client.outcome(goal)
    assert (status, flags) == (GoalStatus.STATUS_CANCELED, S.PREMATURE_HALT)
    assert "after step 1 of 3: stopped" in text


def test_a_plan_without_steps_stops_the_one_that_runs(motion: ScriptedMotionManager, ros_client: Client) -> None:
    goal = begin(motion, ros_client)
    stop = ros_client.send(StepPlan())
    wait_until(lambda: not motion.requests[-1].steps, LIMIT, "the stop at the Motion Manager")
    refused = ros_client.send(plan(first=2))
    assert "is being stopped" in ros_client.outcome(refused)[2]
    assert goal.result is None
    assert stop.result is None
    motion.says("finished", performed=2, reason="stopped")
    assert ros_client.outcome(goal)[:2] == (GoalStatus.STATUS_ABORTED, S.PREMATURE_HALT)
    assert ros_client.outcome(stop)[:2] == (GoalStatus.STATUS_SUCCEEDED, S.PREMATURE_HALT)
    assert [len(request.steps) for request in motion.requests] == [4, 0]


def test_stopping_the_converter_stops_the_plan_and_tells_the_client(
    instance: RunningInstance, motion: ScriptedMotionManager, ros_client: Client
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
