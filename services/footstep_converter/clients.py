"""Who asks for plans over ROS: clients of the action ExecuteStepPlan, and tools that publish a StepPlan.

Both get the same: feedback while the plan runs, and its end. The feedback of every plan is published on a topic too,
where tools that publish, and anybody who watches, find it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Any

from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.task import Future
from rclpy.timer import Timer
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_footstep_planning_msgs.msg import FootstepExecutionStatus, StepPlan

from valor.common.floods import TopicFloods
from valor.footstep_converter.execution import End, Execution, Outcome, aborted
from valor.footstep_converter.feedback import FeedbackMaker, final_state, warn
from valor.footstep_converter.plan import PlannedStep
from valor.ros.lateness import GoalAges, timely

NAMESPACE = "robot_controllers/footstep_controller"
EXECUTE = f"{NAMESPACE}/execute_step_plan"  # the action, and the topic
FEEDBACK = f"{NAMESPACE}/execute_feedback"
RESULT_DELAY = 0.1  # behind the last feedback: a client that has the result takes no more feedback [s]
WORDS = 50  # of feedback kept for watchers: five seconds, in which a lost one is sent again before it is overwritten

FEEDBACK_MESSAGE = ExecuteStepPlan.Impl.FeedbackMessage
"""Feedback with its goal: of an action's types the one that ``ros2 topic`` can import by its name."""
_log = logging.getLogger("footstep_converter")
_STEADY = Clock(clock_type=ClockType.STEADY_TIME)

Report = Callable[[ExecuteStepPlan.Feedback], None]


class Goal:
    """A plan asked for, and the way to say how it went. As it is, of the topic: nobody waits for a result.

    Attributes:
        plan: asked for.
        warning: that its feedback carries; empty: none.
        ended: the client has been told the outcome.
    """

    def __init__(self, plan: StepPlan, report: Report, maker: FeedbackMaker) -> None:
        self.plan = plan
        self.warning = ""
        self.ended = False
        self._report = report
        self._maker = maker

    @property
    def cancel_requested(self) -> bool:
        """Whether the client no longer wants it."""
        return False

    def waits(self, steps: Sequence[PlannedStep]) -> None:
        """Tell the client that these steps are being handed over."""
        self._report(warn(self._maker.waiting(steps), self.warning))

    def progress(self, execution: Execution | None) -> None:
        """Tell the client where the plan is; None: nothing is known of it."""
        self._report(warn(self._maker.progress(execution), self.warning))

    def end(self, outcome: Outcome, execution: Execution | None = None) -> None:
        """Tell the client how it ended; once."""
        if not self.ended:
            self.ended = True
            self._report(warn(self._maker.end(outcome, execution), self.warning))
            self._settle(outcome)

    def _settle(self, outcome: Outcome) -> None:
        """The client has heard the last feedback."""


class ActionGoal(Goal):
    """A goal of the action. Its result comes a little behind the last feedback."""

    def __init__(
        self,
        handle: ServerGoalHandle,
        executor: Any,
        node: Node,
        report: Callable[[ExecuteStepPlan.Feedback, Any], None],
        maker: FeedbackMaker,
    ) -> None:
        def tell(feedback: ExecuteStepPlan.Feedback) -> None:
            handle.publish_feedback(feedback)
            report(feedback, handle.goal_id)

        super().__init__(handle.request.step_plan, tell, maker)
        self._handle = handle
        self._node = node
        self._outcome = Future(executor=executor)

    @property
    def cancel_requested(self) -> bool:
        """Whether the client no longer wants it."""
        return bool(self._handle.is_cancel_requested)

    def _settle(self, outcome: Outcome) -> None:
        def settle() -> None:
            self._node.destroy_timer(timer)
            self._outcome.set_result(outcome)

        timer: Timer = self._node.create_timer(RESULT_DELAY, settle, clock=_STEADY)

    async def result(self) -> ExecuteStepPlan.Result:
        """Wait for the end; then the goal's terminal state is set and its result returned."""
        outcome: Outcome = await self._outcome
        if outcome.end is End.SUCCEEDED:
            self._handle.succeed()
        elif outcome.end is End.CANCELED and self._handle.is_cancel_requested:
            self._handle.canceled()
        else:
            self._handle.abort()
        result = ExecuteStepPlan.Result()
        result.status.header.frame_id = self._maker.frame
        result.status.status = outcome.status
        result.controller_state = final_state(outcome)
        return result


class Clients:
    """Serves the action and the topic. ``begin`` is given each new goal, ``stop`` each that its client cancels.

    Attributes:
        floods: of the topic.
    """

    def __init__(
        self,
        node: Node,
        executor: Any,
        begin: Callable[[Goal], None],
        stop: Callable[[Goal], None],
        *,
        now: Callable[[], int],
        frame: str,
        others: bool = False,
    ) -> None:
        """``now``: gives robot time [ns]; ``frame``: odom, as tf names it; ``others``: computers that may command."""
        self._node = node
        self._executor = executor
        self._begin = begin
        self._stop = stop
        self._maker = FeedbackMaker(now, frame)
        self._goals: dict[bytes, ActionGoal] = {}
        latched = QoSProfile(depth=WORDS, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._feedback = node.create_publisher(FEEDBACK_MESSAGE, FEEDBACK, latched)
        self.floods = TopicFloods(lambda topic: (one.node_name for one in node.get_publishers_info_by_topic(topic)))
        topic = node.resolve_topic_name(EXECUTE)
        published = self.floods.counted(topic, self._published)
        node.create_subscription(StepPlan, EXECUTE, timely(topic, published, others=others), 10)
        self._ages = GoalAges(node, ExecuteStepPlan, EXECUTE) if others else None
        # Every goal is accepted and then refused with a result: ROS has no words for a rejected goal.
        self._server = ActionServer(node, ExecuteStepPlan, EXECUTE, self._execute, cancel_callback=self._cancel)

    def _published(self, plan: StepPlan) -> None:
        self._begin(Goal(plan, self._tell, self._maker))

    def _tell(self, feedback: ExecuteStepPlan.Feedback, goal_id: Any = None) -> None:
        """Whoever watches; of a plan that was published there is no goal."""
        message = FEEDBACK_MESSAGE(feedback=feedback)
        if goal_id is not None:
            message.goal_id = goal_id
        self._feedback.publish(message)

    async def _execute(self, handle: ServerGoalHandle) -> ExecuteStepPlan.Result:
        goal = ActionGoal(handle, self._executor, self._node, self._tell, self._maker)
        key = bytes(handle.goal_id.uuid)
        self._goals[key] = goal
        try:
            if self._ages is not None and (why := self._ages.late(handle)):
                _log.warning("plan refused: %s", why)
                goal.end(aborted(FootstepExecutionStatus.ERR_UNKNOWN, why))
            else:
                self._begin(goal)
            return await goal.result()
        finally:
            del self._goals[key]

    def _cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        goal = self._goals.get(bytes(handle.goal_id.uuid))
        if goal is not None and goal.ended:
            return CancelResponse.REJECT
        if goal is not None:
            self._stop(goal)
        return CancelResponse.ACCEPT  # without a goal: it has not begun, and will not

    @property
    def open_goals(self) -> list[ActionGoal]:
        """Goals whose clients wait for a result."""
        return list(self._goals.values())

    def close(self) -> None:
        """No goals any more."""
        self._server.destroy()
        if self._ages is not None:
            self._ages.destroy()
