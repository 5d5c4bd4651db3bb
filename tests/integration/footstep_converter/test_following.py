"""A plan is handed over, and its client receives where it is."""

import importlib
import math
import time
from typing import Any

import numpy as np
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import TransformStamped
from rclpy.qos import DurabilityPolicy, QoSProfile
from tf2_msgs.msg import TFMessage
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_footstep_planning_msgs.msg import StepPlan

from harness.instance import RunningInstance
from harness.waiting import wait_until
from tests.integration.footstep_converter.scripted_motion_manager import ScriptedMotionManager, begin
from tests.integration.plan_client import ACTION, FEEDBACK, LIMIT, PlanClient, S, plan
from valor.common.messages import FootstepPlanRequest
from valor.common.topics import STATISTICS

FEEDBACK_PERIOD = 0.1  # [s]


def test_a_plan_is_executed_and_followed(motion: ScriptedMotionManager, ros_client: PlanClient) -> None:
    motion.report("finished", performed=3, reason="the plan before")

    def robot_time() -> int:
        """As a refusal is stamped with; 0 until it is received."""
        refused = ros_client.send(StepPlan())
        ros_client.outcome(refused)
        return int(refused.last_words.header.stamp.sec)

    wait_until(lambda: robot_time() >= 5, LIMIT, "robot time")
    goal = ros_client.send(plan())
    wait_until(lambda: motion.requests, LIMIT, "the plan at the Motion Manager")
    waiting = wait_until(lambda: goal.feedback, LIMIT, "feedback while it is handed over")[0]
    assert (waiting.controller_state, waiting.stepping_status) == (waiting.READY, S.WAITING_FOR_ATLAS)
    assert waiting.header.stamp.sec >= 5 and waiting.queue_size == 4 and waiting.status.warning_msg == ""
    assert (waiting.first_queued_step_index, waiting.last_queued_step_index) == (0, 3)
    assert (waiting.last_performed_step_index, waiting.first_changeable_step_index) == (-1, 0)
    sent = motion.requests[0].steps
    assert [(s.step_index, s.foot) for s in sent] == [(0, 0), (1, 1), (2, 0), (3, 1)]
    np.testing.assert_array_equal(sent[2].position_in_odom, [0.2 * 3, 0.11, 0.0])
    np.testing.assert_array_equal(sent[2].orientation_in_odom, [1.0, 0.0, 0.0, 0.0])
    assert sent[2].swing_duration == 0.75

    motion.behavior = "step"
    motion.report("executing", performed=0, executing=1, queue=3, changeable=2)
    wait_until(lambda: any(f.currently_executing_step_index == 1 for f in goal.feedback), LIMIT, "feedback of step 1")
    seen = goal.feedback[-1]
    assert (seen.controller_state, seen.stepping_status) == (seen.ACTIVE, S.EXECUTING_STEP_PLAN)
    assert (seen.queue_size, seen.first_queued_step_index, seen.last_queued_step_index) == (3, 1, 3)
    assert (seen.last_performed_step_index, seen.first_changeable_step_index) == (0, 2) and seen.header.stamp.sec >= 5
    assert goal.result is None

    motion.behavior = "stand"
    motion.report("finished", performed=3)
    assert ros_client.outcome(goal) == (GoalStatus.STATUS_SUCCEEDED, S.REACHED_GOAL, "")
    assert goal.result.result.controller_state == ExecuteStepPlan.Feedback.FINISHED  # type: ignore[attr-defined]  # set by a callback
    assert len(motion.requests) == 1

    again = ros_client.send(plan())
    wait_until(lambda: len(motion.requests) == 2, LIMIT, "the same plan again")
    motion.behavior = "step"
    motion.report("executing", performed=0, executing=1, queue=3, changeable=2)
    wait_until(lambda: any(f.currently_executing_step_index == 1 for f in again.feedback), LIMIT, "feedback of step 1")
    motion.behavior = "stand"
    motion.report("finished", performed=3)
    assert ros_client.outcome(again)[1] == S.REACHED_GOAL


def test_feedback_comes_ten_times_a_second_and_with_every_step(
    instance: RunningInstance, motion: ScriptedMotionManager, ros_client: PlanClient
) -> None:
    """Not more often by the wall, and often beside what else the converter reports by the clock, once a second."""
    statistics = STATISTICS["footstep_converter"].subscriber(instance.node("watch"), queue=1000)
    began = time.monotonic()
    goal = begin(motion, ros_client)
    statistics.drain()
    wait_until(lambda: len(goal.feedback) >= 30, LIMIT, "feedback")
    received, lasted = len(goal.feedback), time.monotonic() - began
    assert received < 1.5 * lasted / FEEDBACK_PERIOD + 5.0  # the first come with the goal
    assert received > 3 * (len(statistics.drain()) - 1)

    for executing in range(2, 4):  # two steps within one look of the converter at the Motion Manager
        motion.report("executing", performed=executing - 1, executing=executing, changeable=executing + 1)
        motion.publish()
    wait_until(lambda: goal.feedback[-1].currently_executing_step_index == 3, LIMIT, "the last step")
    motion.report("finished", performed=3)
    assert ros_client.outcome(goal)[1] == S.REACHED_GOAL
    indices = [
        (f.last_performed_step_index, f.currently_executing_step_index, f.first_changeable_step_index)
        for f in goal.feedback
        if f.controller_state == f.ACTIVE
    ]
    assert {executing for _, executing, _ in indices} >= {1, 2, 3} and indices == sorted(indices)


def test_steps_begun_before_the_acceptance_are_reported(motion: ScriptedMotionManager, ros_client: PlanClient) -> None:
    def at_once(request: FootstepPlanRequest) -> tuple[bool, str]:
        for state, executing in (("idle", -1), ("executing", 0), ("executing", 1)):
            motion.report(state, performed=max(executing - 1, -1), executing=executing, changeable=executing + 1)
            motion.publish()
        motion.behavior = "step"
        return True, ""

    motion.accepts = at_once
    goal = ros_client.send(plan())
    wait_until(lambda: any(f.currently_executing_step_index == 1 for f in goal.feedback), LIMIT, "feedback of step 1")
    assert 0 in {f.currently_executing_step_index for f in goal.feedback if f.controller_state == f.ACTIVE}


def get_message_by_name(node: Any, topic: str) -> Any:
    """The type of a topic, found as ``ros2 topic echo`` finds it: a message, or an action's FeedbackMessage."""
    types = wait_until(lambda: dict(node.get_topic_names_and_types()).get(topic), LIMIT, topic)
    package, kind, name = types[0].split("/")
    module = importlib.import_module(f"{package}.{kind}")
    action, _, impl = name.partition("_")
    return getattr(getattr(module, action).Impl, impl) if name.endswith("_FeedbackMessage") else getattr(module, name)


def test_a_tool_may_publish_its_plan(motion: ScriptedMotionManager, ros_client: PlanClient) -> None:
    received: list[Any] = []
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    reported = get_message_by_name(ros_client.node, FEEDBACK)
    ros_client.node.create_subscription(reported, FEEDBACK, lambda message: received.append(message.feedback), latched)
    publisher = ros_client.node.create_publisher(StepPlan, ACTION, 1)
    wait_until(publisher.get_subscription_count, LIMIT, "the converter's subscription")
    wrong = plan(count=3)
    wrong.steps[1].step_index = 7
    publisher.publish(wrong)
    wait_until(
        lambda: received and received[-1].stepping_status == S.ERR_INVALID_INCONSISTENT_INDICES, LIMIT, "the refusal"
    )
    assert "step 7 at the position of step 1" in received[-1].status.error_msg
    publisher.publish(plan())
    wait_until(lambda: motion.requests, LIMIT, "the plan at the Motion Manager")
    motion.behavior = "step"
    motion.report("executing", performed=0, executing=1, queue=2, changeable=2)
    wait_until(lambda: received[-1].currently_executing_step_index == 1, LIMIT, "step 1")
    publisher.publish(StepPlan())
    wait_until(lambda: not motion.requests[-1].steps, LIMIT, "the stop")
    motion.behavior = "stand"
    motion.report("finished", performed=2, reason="stopped")
    wait_until(lambda: received[-1].controller_state in (received[-1].FINISHED, received[-1].FAILED), LIMIT, "the end")
    assert S.PREMATURE_HALT in [feedback.stepping_status for feedback in received]


class Tf:
    def __init__(self, client: PlanClient) -> None:
        self._publisher = client.node.create_publisher(TFMessage, "/tf", 100)

    def report(self, seconds: int, x: float, child: str = "map") -> None:
        """``child`` is ``x`` [m] ahead in odom at a time [s], and heads to the left."""
        transform = TransformStamped(child_frame_id=child)
        transform.header.frame_id = "odom"
        transform.header.stamp.sec = seconds
        transform.transform.translation.x = x
        transform.transform.rotation.z = transform.transform.rotation.w = math.sqrt(0.5)
        self._publisher.publish(TFMessage(transforms=[transform]))


def test_a_plan_in_another_frame_is_put_in_odom(motion: ScriptedMotionManager, ros_client: PlanClient) -> None:
    tf = Tf(ros_client)
    motion.report("finished", time=100_000_000_000)
    elsewhere = plan()
    elsewhere.header.frame_id = "map"

    def known() -> bool:
        """Return whether the converter receives tf: it reports that a plan is older than what it has received."""
        tf.report(100, 1.0)
        tf.report(101, 2.0)
        elsewhere.header.stamp.sec = 95
        return "before the oldest" in ros_client.outcome(ros_client.send(elsewhere))[2]

    wait_until(known, LIMIT, "tf at the converter", period=0.2)
    elsewhere.header.stamp.sec = 105
    assert "ahead of the latest transform, and none was received" in ros_client.outcome(ros_client.send(elsewhere))[2]
    assert not motion.requests

    elsewhere.header.stamp.sec, elsewhere.header.stamp.nanosec = 101, 500_000_000  # a little ahead of tf
    goal = ros_client.send(elsewhere)
    wait_until(lambda: goal.handle, LIMIT, "the goal")
    tf.report(102, 3.0)
    wait_until(lambda: motion.requests, LIMIT, "the plan at the Motion Manager")
    for step, straight in zip(motion.requests[0].steps, elsewhere.steps, strict=True):
        p = straight.foot.pose.position
        np.testing.assert_allclose(step.position_in_odom, [2.5 - p.y, p.x, p.z], atol=1e-9)
        np.testing.assert_allclose(step.orientation_in_odom, [math.sqrt(0.5), 0, 0, math.sqrt(0.5)], atol=1e-9)
