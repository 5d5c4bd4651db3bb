"""A client of the converter's action, and the plans that it sends."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import rclpy
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_footstep_planning_msgs.msg import Foot, FootstepExecutionStatus, Step, StepPlan

from harness.system import in_executor
from harness.waiting import wait_until

S = FootstepExecutionStatus
ACTION = "/robot_controllers/footstep_controller/execute_step_plan"
FEEDBACK = "/robot_controllers/footstep_controller/execute_feedback"
LIMIT = 30.0  # for anything to happen on a loaded machine [s]


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
        self.node.create_subscription(
            ExecuteStepPlan.Impl.FeedbackMessage, FEEDBACK, lambda m: self._words.append(m.feedback), latched
        )
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
