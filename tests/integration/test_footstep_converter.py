"""The converter's process between an rclpy client and a scripted Motion Manager, over real DDS and real Bifrost."""

from __future__ import annotations

import math
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import rclpy
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import TransformStamped
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from tf2_msgs.msg import TFMessage
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_footstep_planning_msgs.msg import ErrorStatus, Foot, FootstepExecutionStatus, Step, StepPlan

import bifrost
from harness.instance import RunningInstance, fresh_instance
from harness.system import in_executor
from harness.waiting import wait_until
from valor.common.messages import FootstepPlanReply, FootstepPlanRequest, MotionState, StepStatus
from valor.common.topics import FOOTSTEP_PLAN, MOTION_STATE, STATISTICS, STEP_STATUS

S = FootstepExecutionStatus
ACTION = "/robot_controllers/footstep_controller/execute_step_plan"
FEEDBACK = "/robot_controllers/footstep_controller/execute_feedback"
LIMIT = 30.0  # for anything to happen on a loaded machine [s]
FEEDBACK_PERIOD = 0.1  # [s]


class ScriptedMotionManager:
    """Answers plans as it is told and says of itself what it is told, 50 times a second."""

    def __init__(self, node: bifrost.Node) -> None:
        self._node = node
        self.requests: list[FootstepPlanRequest] = []
        self.accepts: Callable[[FootstepPlanRequest], tuple[bool, str]] = lambda request: (True, "")
        self.behavior, self.reason = "stand", ""
        self.step_status: StepStatus | None = None
        self.silent = False
        self._server = FOOTSTEP_PLAN.server(node, self._answer)
        # Latched, for such a publisher alone knows who hears it.
        self._state = node.publisher(MOTION_STATE.name, MotionState, latched=True)
        self._status = node.publisher(STEP_STATUS.name, StepStatus, latched=True)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _answer(self, request: FootstepPlanRequest, origin: str) -> FootstepPlanReply:
        assert origin == "footstep_converter"
        self.requests.append(request)
        accepted, reason = self.accepts(request)
        return FootstepPlanReply(accepted=accepted, behavior=self.behavior, reason=reason)

    def says(self, state: str, performed: int = -1, executing: int = -1, **more: Any) -> None:
        """What it says of the plan from now on."""
        self.step_status = StepStatus(
            time=more.get("time", 5_000_000_000),
            state=state,
            reason=more.get("reason", ""),
            queue_size=more.get("queue", 0),
            last_performed_step_index=performed,
            executing_step_index=executing,
            first_changeable_step_index=more.get("changeable", -1),
        )

    def publish(self, status: StepStatus) -> None:
        """Say it now."""
        self._status.publish(status)

    def wait_until_heard(self) -> None:
        """Until the converter hears what is said of the plan."""
        wait_until(lambda: self._status.subscribers, LIMIT, "a subscriber to the step status")

    def wait_until_seen(self) -> None:
        """Until the converter hears what is said of the robot, which it does while a plan runs."""
        wait_until(lambda: self._state.subscribers, LIMIT, "a subscriber to the motion state")

    def _run(self) -> None:
        three, four = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
        while not self._stop.wait(0.02):
            if self.silent:
                continue
            self._server.serve()
            status = self.step_status
            if status is not None:
                status.time += 1_000_000
                self._status.publish(status)
            state = MotionState(
                time=status.time + 1 if status else 0, proprioceptor_sequence=0, behavior=self.behavior,
                locomotion="", manipulation="", attention="", reason=self.reason,
                pelvis_position_in_odom=three, pelvis_orientation_in_odom=four,
                pelvis_linear_velocity_in_odom=three, pelvis_angular_velocity_in_pelvis=three, com_in_odom=three,
                dcm_in_odom=three, dcm_reference_in_odom=three, cop_in_odom=np.zeros(2),
                contacts=np.ones(2, dtype=np.uint8), contact_probability=np.ones(2), pelvis_position_variance=three,
                pelvis_orientation_variance=three, pelvis_linear_velocity_variance=three,
                hand_contacts=np.zeros(2, dtype=np.uint8), left_arm="", right_arm="", joint_setpoint=np.zeros(38),
                pelvis_setpoint=np.zeros(6), pelvis_in_support=np.zeros(6), desired_foot_forces=np.zeros(2),
                qp_status=1, qp_failures=0, torque_saturations=0, motor_time=0.0, tick_time=0.0,
            )  # fmt: skip
            self._state.publish(state)

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._node.close()


@dataclass
class Goal:
    """A goal sent, and what has been heard of it."""

    since: int = 0  # of the words on the topic, those behind so many are about it, or another
    handle: Any = None
    feedback: list[Any] = field(default_factory=list)
    result: Any = None
    last_words: Any = None  # once the outcome is known


class Client:
    """An ordinary rclpy action client, spun in a thread."""

    def __init__(self, domain: int) -> None:
        self.goals: list[Goal] = []
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain)
        self.node = rclpy.create_node("planner", context=self._context)
        self._client = ActionClient(self.node, ExecuteStepPlan, ACTION)
        # A client of an action forgets a goal with its result; feedback that comes behind is on the topic alone.
        self._words: list[Any] = []
        latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(ExecuteStepPlan.Feedback, FEEDBACK, self._words.append, latched)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._thread = ThreadPoolExecutor(1)
        self._spinning = self._thread.submit(self._executor.spin)
        self.wait_for_server()

    def wait_for_server(self) -> None:
        assert self._client.wait_for_server(LIMIT), f"no {ACTION}"

    def send(self, plan: StepPlan) -> Goal:
        goal = Goal(len(self._words))
        self.goals.append(goal)
        future = in_executor(
            self._executor, self._client.send_goal_async, ExecuteStepPlan.Goal(step_plan=plan),
            feedback_callback=lambda m: goal.feedback.append(m.feedback),
        )  # fmt: skip
        goal.handle = wait_until(future.result, LIMIT, "the goal's response")
        assert goal.handle.accepted
        ended = in_executor(self._executor, goal.handle.get_result_async)
        ended.add_done_callback(lambda f: setattr(goal, "result", f.result()))
        return goal

    def cancel(self, goal: Goal) -> None:
        in_executor(self._executor, goal.handle.cancel_goal_async)

    def outcome(self, goal: Goal) -> tuple[int, int, str]:
        """Terminal state, flags and text."""
        wait_until(lambda: goal.result, LIMIT, "the goal's result")
        flags = goal.result.result.status.status

        def last_words() -> Any:
            heard = reversed([*goal.feedback, *self._words[goal.since :]])
            return next((words for words in heard if words.stepping_status == flags), None)

        goal.last_words = wait_until(last_words, LIMIT, "the last words")
        return goal.result.status, flags, goal.last_words.status.error_msg

    def close(self) -> None:
        self._executor.shutdown()
        self._spinning.result(LIMIT)
        self._thread.shutdown()
        self._client.destroy()
        self.node.destroy_node()
        self._context.try_shutdown()


def plan(first: int = 0, count: int = 4) -> StepPlan:
    """Straight ahead from the origin."""
    made = StepPlan()
    made.header.frame_id = "odom"
    for i in range(first, first + count):
        step = Step(step_index=i, valid=True, swing_height=0.08, step_duration=0.75, sway_duration=0.5)
        step.foot.foot_index = Foot.LEFT if i % 2 == 0 else Foot.RIGHT
        step.foot.pose.position.x = 0.2 * (i + 1)
        step.foot.pose.position.y = 0.11 if step.foot.foot_index == Foot.LEFT else -0.11
        made.steps.append(step)
    return made


@pytest.fixture(scope="module")
def instance() -> Iterator[RunningInstance]:
    """With the converter running: the same for all."""
    home = Path(tempfile.mkdtemp(prefix="valor-"))
    with fresh_instance(home) as running, pytest.MonkeyPatch.context() as environment:
        for name, value in running.instance.environment().items():
            environment.setenv(name, value)
        running.start("footstep_converter", wait=True)
        yield running
    shutil.rmtree(home, ignore_errors=True)


@pytest.fixture(scope="module")
def ros_client(instance: RunningInstance) -> Iterator[Client]:
    """A client of its action."""
    client = Client(instance.settings.ros_domain_id)
    yield client
    client.close()


@pytest.fixture
def motion(instance: RunningInstance, ros_client: Client) -> Iterator[ScriptedMotionManager]:
    """One for each test; a fall ends whatever plan a test leaves behind."""
    scripted = ScriptedMotionManager(bifrost.Node("motion_manager", network=instance.network))
    scripted.wait_until_heard()
    yield scripted
    scripted.silent, scripted.behavior = False, "fall"
    try:
        wait_until(lambda: all(goal.result for goal in ros_client.goals), LIMIT, "the end of all goals")
    finally:
        ros_client.goals.clear()
        scripted.close()


def test_without_a_motion_manager_the_error_says_so(ros_client: Client) -> None:
    def said() -> str:
        status, flags, text = ros_client.outcome(ros_client.send(plan()))
        assert (status, flags) == (GoalStatus.STATUS_ABORTED, S.ERR_CONTROLLER_NOT_READY)
        return text

    wait_until(lambda: "no Motion Manager" in said(), LIMIT, "the one before to be forgotten")


def test_a_plan_is_executed_and_followed(motion: ScriptedMotionManager, ros_client: Client) -> None:
    motion.says("finished", performed=3, reason="the plan before")
    goal = ros_client.send(plan())
    wait_until(lambda: motion.requests, LIMIT, "the plan at the Motion Manager")
    sent = motion.requests[0].steps
    assert [(s.step_index, s.foot) for s in sent] == [(0, 0), (1, 1), (2, 0), (3, 1)]
    np.testing.assert_array_equal(sent[2].position_in_odom, [0.2 * 3, 0.11, 0.0])
    np.testing.assert_array_equal(sent[2].orientation_in_odom, [1.0, 0.0, 0.0, 0.0])
    assert sent[2].swing_duration == 0.75

    motion.behavior = "step"
    motion.says("executing", performed=0, executing=1, queue=3, changeable=2)
    wait_until(lambda: any(f.currently_executing_step_index == 1 for f in goal.feedback), LIMIT, "feedback of step 1")
    seen = goal.feedback[-1]
    assert (seen.controller_state, seen.stepping_status) == (seen.ACTIVE, S.EXECUTING_STEP_PLAN)
    assert (seen.queue_size, seen.first_queued_step_index, seen.last_queued_step_index) == (3, 1, 3)
    assert (seen.last_performed_step_index, seen.first_changeable_step_index) == (0, 2)
    assert seen.header.stamp.sec >= 5
    assert goal.result is None

    motion.behavior = "stand"
    motion.says("finished", performed=3)
    assert ros_client.outcome(goal) == (GoalStatus.STATUS_SUCCEEDED, S.REACHED_GOAL, "")
    assert goal.result.result.controller_state == ExecuteStepPlan.Feedback.FINISHED  # type: ignore[attr-defined]  # set by a callback
    assert len(motion.requests) == 1


def test_feedback_comes_ten_times_a_second_and_with_every_step(
    instance: RunningInstance, motion: ScriptedMotionManager, ros_client: Client
) -> None:
    """Not more often by the wall, and often beside what else the converter says by the clock, once a second."""
    statistics = STATISTICS["footstep_converter"].subscriber(instance.node("watch"), queue=1000)
    began = time.monotonic()
    goal = begin(motion, ros_client)
    statistics.drain()
    wait_until(lambda: len(goal.feedback) >= 30, LIMIT, "feedback")
    heard, lasted = len(goal.feedback), time.monotonic() - began
    assert heard < 1.5 * lasted / FEEDBACK_PERIOD + 5.0  # the first come with the goal
    assert heard > 3 * (len(statistics.drain()) - 1)

    for executing in range(2, 4):  # two steps within one look of the converter at the Motion Manager
        motion.says("executing", performed=executing - 1, executing=executing, changeable=executing + 1)
        assert motion.step_status is not None
        motion.publish(motion.step_status)
    wait_until(lambda: goal.feedback[-1].currently_executing_step_index == 3, LIMIT, "the last step")
    motion.says("finished", performed=3)
    assert ros_client.outcome(goal)[1] == S.REACHED_GOAL
    indices = [
        (f.last_performed_step_index, f.currently_executing_step_index, f.first_changeable_step_index)
        for f in goal.feedback
        if f.controller_state == f.ACTIVE
    ]
    assert {executing for _, executing, _ in indices} >= {1, 2, 3}
    assert indices == sorted(indices)


def test_steps_that_begin_before_the_acceptance_is_heard_are_told(
    motion: ScriptedMotionManager, ros_client: Client
) -> None:
    def at_once(request: FootstepPlanRequest) -> tuple[bool, str]:
        for state, executing in (("idle", -1), ("executing", 0), ("executing", 1)):
            motion.says(state, performed=max(executing - 1, -1), executing=executing, changeable=executing + 1)
            assert motion.step_status is not None
            motion.publish(motion.step_status)
        motion.behavior = "step"
        return True, ""

    motion.accepts = at_once
    goal = ros_client.send(plan())
    wait_until(lambda: any(f.currently_executing_step_index == 1 for f in goal.feedback), LIMIT, "feedback of step 1")
    assert 0 in {f.currently_executing_step_index for f in goal.feedback if f.controller_state == f.ACTIVE}


def test_a_refusal_is_passed_on_word_for_word(motion: ScriptedMotionManager, ros_client: Client) -> None:
    motion.accepts = lambda request: (False, "stepping is not available yet")
    goal = ros_client.send(plan())
    assert ros_client.outcome(goal) == (
        GoalStatus.STATUS_ABORTED,
        S.ERR_CONTROLLER_NOT_READY,
        "stepping is not available yet",
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


def test_a_silent_motion_manager_is_told_to_stop(motion: ScriptedMotionManager, ros_client: Client) -> None:
    motion.silent = True
    goal = ros_client.send(plan())
    status, flags, text = ros_client.outcome(goal)
    assert (status, flags) == (GoalStatus.STATUS_ABORTED, S.ERR_CONTROLLER_NOT_READY)
    assert "did not answer" in text
    motion.silent = False
    wait_until(lambda: motion.requests and not motion.requests[-1].steps, LIMIT, "the stop")


def begin(motion: ScriptedMotionManager, client: Client) -> Goal:
    """A plan under way."""
    motion.requests.clear()
    goal = client.send(plan())
    wait_until(lambda: motion.requests, LIMIT, "the plan at the Motion Manager")
    motion.behavior = "step"
    motion.says("executing", performed=0, executing=1, queue=3, changeable=2)
    wait_until(lambda: any(f.currently_executing_step_index == 1 for f in goal.feedback), LIMIT, "the plan under way")
    motion.wait_until_seen()
    return goal


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
        assert motion.step_status is not None
        motion.publish(motion.step_status)
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


class Tf:
    """A node that says where the frame ``map`` is."""

    def __init__(self, client: Client) -> None:
        self._publisher = client.node.create_publisher(TFMessage, "/tf", 100)

    def says(self, seconds: int, x: float, child: str = "map") -> None:
        """``child`` is ``x`` [m] ahead in odom at a time [s], and heads to the left."""
        transform = TransformStamped(child_frame_id=child)
        transform.header.frame_id = "odom"
        transform.header.stamp.sec = seconds
        transform.transform.translation.x = x
        transform.transform.rotation.z = transform.transform.rotation.w = math.sqrt(0.5)
        self._publisher.publish(TFMessage(transforms=[transform]))


def test_a_plan_in_another_frame_is_put_in_odom(motion: ScriptedMotionManager, ros_client: Client) -> None:
    tf = Tf(ros_client)
    elsewhere = plan()
    elsewhere.header.frame_id = "map"

    def known() -> bool:
        """Whether the converter hears tf: it says that a plan is older than what it has heard."""
        tf.says(100, 1.0)
        tf.says(101, 2.0)
        elsewhere.header.stamp.sec = 1
        return "before the oldest" in ros_client.outcome(ros_client.send(elsewhere))[2]

    wait_until(known, LIMIT, "tf at the converter", period=0.2)
    elsewhere.header.stamp.sec = 200
    assert "ahead of the newest transform, and none came" in ros_client.outcome(ros_client.send(elsewhere))[2]
    assert not motion.requests

    elsewhere.header.stamp.sec, elsewhere.header.stamp.nanosec = 101, 500_000_000  # a little ahead of tf
    goal = ros_client.send(elsewhere)
    wait_until(lambda: goal.handle, LIMIT, "the goal")
    tf.says(102, 3.0)
    wait_until(lambda: motion.requests, LIMIT, "the plan at the Motion Manager")
    for step, straight in zip(motion.requests[0].steps, elsewhere.steps, strict=True):
        p = straight.foot.pose.position
        np.testing.assert_allclose(step.position_in_odom, [2.5 - p.y, p.x, p.z], atol=1e-9)
        np.testing.assert_allclose(step.orientation_in_odom, [math.sqrt(0.5), 0, 0, math.sqrt(0.5)], atol=1e-9)


def test_a_tool_may_publish_its_plan(motion: ScriptedMotionManager, ros_client: Client) -> None:
    heard: list[Any] = []
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    ros_client.node.create_subscription(ExecuteStepPlan.Feedback, FEEDBACK, heard.append, latched)
    publisher = ros_client.node.create_publisher(StepPlan, ACTION, 1)
    wait_until(publisher.get_subscription_count, LIMIT, "the converter's subscription")
    wrong = plan(count=3)
    wrong.steps[1].step_index = 7
    publisher.publish(wrong)
    wait_until(lambda: heard and heard[-1].stepping_status == S.ERR_INVALID_INCONSISTENT_INDICES, LIMIT, "the refusal")
    assert "step 7 stands where step 1 was expected" in heard[-1].status.error_msg
    publisher.publish(plan())
    wait_until(lambda: motion.requests, LIMIT, "the plan at the Motion Manager")
    motion.behavior = "step"
    motion.says("executing", performed=0, executing=1, queue=2, changeable=2)
    wait_until(lambda: heard[-1].currently_executing_step_index == 1, LIMIT, "step 1")
    publisher.publish(StepPlan())
    wait_until(lambda: not motion.requests[-1].steps, LIMIT, "the stop")
    motion.behavior = "stand"
    motion.says("finished", performed=2, reason="stopped")
    wait_until(lambda: heard[-1].controller_state in (heard[-1].FINISHED, heard[-1].FAILED), LIMIT, "the end")
    assert S.PREMATURE_HALT in [feedback.stepping_status for feedback in heard]


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


def test_it_costs_next_to_nothing_at_idle(instance: RunningInstance, motion: ScriptedMotionManager,
                                          ros_client: Client) -> None:  # fmt: skip
    """A rate, not a time: cycles of the processor a second of its own clock, while motion states go by."""
    process = psutil.Process(instance.process("footstep_converter").pid)
    statistics = STATISTICS["footstep_converter"].subscriber(instance.node("watch"), queue=10)
    assert statistics.receive(LIMIT)
    before, began = process.cpu_times(), time.monotonic()
    for _ in range(3):
        assert statistics.receive(LIMIT)
    after, ended = process.cpu_times(), time.monotonic()
    used = (after.user + after.system - before.user - before.system) / (ended - began)
    assert used < 0.25  # some 0.05 where it was measured; a slow machine is not what this is about
