"""Client of the footstep controller's action, and plans for it."""

from dataclasses import dataclass, field
from typing import Any

from rclpy.action import ActionClient
from rclpy.qos import DurabilityPolicy, QoSProfile
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_footstep_planning_msgs.msg import Foot, FootstepExecutionStatus, Step, StepPlan

from harness.system import RosClient
from harness.waiting import wait_until

S = FootstepExecutionStatus
ACTION = "/robot_controllers/footstep_controller/execute_step_plan"
FEEDBACK = "/robot_controllers/footstep_controller/execute_feedback"
LIMIT = 30.0  # for anything to happen on a loaded machine [s]


@dataclass
class Goal:
    """A goal sent, and what has been received about it."""

    since: int = 0  # index of the first message on the feedback topic that can be about it
    handle: Any = None
    feedback: list[Any] = field(default_factory=list)
    result: Any = None
    last_words: Any = None  # feedback with the final flags, once the outcome is known

    @property
    def executing(self) -> int:
        """Index of the step under way; -1 before the first."""
        return int(self.feedback[-1].currently_executing_step_index) if self.feedback else -1

    @property
    def active(self) -> list[Any]:
        return [each for each in self.feedback if each.controller_state == each.ACTIVE]


class PlanClient:
    def __init__(self, ros: RosClient) -> None:
        self.ros, self.node = ros, ros.node
        self.goals: list[Goal] = []
        self._client = ActionClient(self.node, ExecuteStepPlan, ACTION)
        # An action client discards a goal with its result; later feedback is on the topic only.
        self._words: list[Any] = []
        latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(
            ExecuteStepPlan.Impl.FeedbackMessage, FEEDBACK, lambda m: self._words.append(m.feedback), latched
        )
        self.wait_for_server()

    def wait_for_server(self) -> None:
        assert self._client.wait_for_server(4 * LIMIT), f"no {ACTION}"

    def send(self, plan: StepPlan) -> Goal:
        goal = Goal(len(self._words))
        self.goals.append(goal)
        request = ExecuteStepPlan.Goal(step_plan=plan)
        sent = self.ros._call(
            self._client.send_goal_async, request, lambda message: goal.feedback.append(message.feedback)
        )
        goal.handle = self.ros._wait(sent, 4 * LIMIT, "the goal's response")
        assert goal.handle.accepted
        ended = self.ros._call(goal.handle.get_result_async)
        ended.add_done_callback(lambda done: setattr(goal, "result", done.result()))
        return goal

    def cancel(self, goal: Goal) -> None:
        self.ros._call(goal.handle.cancel_goal_async)

    def outcome(self, goal: Goal) -> tuple[int, int, str]:
        """Terminal state, flags and text."""
        wait_until(lambda: goal.result, LIMIT, "the goal's result")
        flags = int(goal.result.result.status.status)

        def last_words() -> Any:
            received = reversed([*goal.feedback, *self._words[goal.since :]])
            return next((words for words in received if words.stepping_status == flags), None)

        goal.last_words = wait_until(last_words, LIMIT, "the last feedback")
        return goal.result.status, flags, str(goal.last_words.status.error_msg)


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
