"""The ROS side: the ExecuteStepPlan action and its messages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from rclpy.task import Future
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_footstep_planning_msgs.msg import FootstepExecutionStatus, StepPlan

from footstep_converter.execution import End, Execution, Outcome
from footstep_converter.plan import ODOM

ACTION = "/robot_controllers/footstep_controller/execute_step_plan"


class Goal:
    """One goal of the action: the plan asked for, and the way to say how it went."""

    def __init__(self, handle: ServerGoalHandle, executor: Any) -> None:
        self._handle = handle
        self._outcome = Future(executor=executor)

    @property
    def plan(self) -> StepPlan:
        """The plan asked for."""
        plan: StepPlan = self._handle.request.step_plan
        return plan

    @property
    def cancel_requested(self) -> bool:
        """Whether the client no longer wants it."""
        return bool(self._handle.is_cancel_requested)

    @property
    def ended(self) -> bool:
        """Whether the client has been told the outcome."""
        return bool(self._outcome.done())

    def progress(self, execution: Execution | None) -> None:
        """Tell the client where the plan is; None: it is being handed over."""
        self._handle.publish_feedback(_progress(execution))

    def end(self, outcome: Outcome, execution: Execution | None = None) -> None:
        """Tell the client how it ended. The result has no text: the last feedback carries it."""
        if self.ended:
            return
        feedback = _progress(execution)
        feedback.controller_state = _final_state(outcome)
        feedback.stepping_status = outcome.status
        feedback.status.error = outcome.error
        feedback.status.error_msg = outcome.text
        self._handle.publish_feedback(feedback)
        self._outcome.set_result(outcome)

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
        result.status.header.frame_id = ODOM
        result.status.status = outcome.status
        result.controller_state = _final_state(outcome)
        return result


class StepPlanAction:
    """Serves the action. ``begin`` is given each new goal, ``stop`` each that its client cancels."""

    def __init__(self, node: Node, executor: Any, begin: Callable[[Goal], None], stop: Callable[[Goal], None]) -> None:
        self._executor = executor
        self._begin = begin
        self._stop = stop
        self._goals: dict[bytes, Goal] = {}
        # Every goal is accepted and then refused with a result: ROS has no words for a rejected goal.
        self._server = ActionServer(node, ExecuteStepPlan, ACTION, self._execute, cancel_callback=self._cancel)

    async def _execute(self, handle: ServerGoalHandle) -> ExecuteStepPlan.Result:
        goal = Goal(handle, self._executor)
        key = bytes(handle.goal_id.uuid)
        self._goals[key] = goal
        try:
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
    def open_goals(self) -> list[Goal]:
        """Goals whose clients wait for a result."""
        return list(self._goals.values())

    def close(self) -> None:
        """No goals any more."""
        self._server.destroy()


def _final_state(outcome: Outcome) -> int:
    return int(ExecuteStepPlan.Feedback.FINISHED if outcome.end is End.SUCCEEDED else ExecuteStepPlan.Feedback.FAILED)


def _progress(execution: Execution | None) -> ExecuteStepPlan.Feedback:
    feedback = ExecuteStepPlan.Feedback()
    feedback.header.frame_id = ODOM
    feedback.first_queued_step_index = feedback.last_queued_step_index = -1
    feedback.last_performed_step_index = -1
    feedback.currently_executing_step_index = -1
    feedback.first_changeable_step_index = -1
    status = execution.status if execution is not None else None
    if execution is None or status is None:
        feedback.controller_state = int(ExecuteStepPlan.Feedback.READY)
        feedback.stepping_status = int(FootstepExecutionStatus.WAITING_FOR_ATLAS)
        return feedback
    feedback.header.stamp = Time(sec=status.time // 10**9, nanosec=status.time % 10**9)
    feedback.controller_state = int(ExecuteStepPlan.Feedback.ACTIVE)
    feedback.stepping_status = int(FootstepExecutionStatus.EXECUTING_STEP_PLAN)
    feedback.queue_size = status.queue_size
    if status.queue_size > 0:
        feedback.first_queued_step_index = execution.last_index - status.queue_size + 1
        feedback.last_queued_step_index = execution.last_index
    feedback.last_performed_step_index = status.last_performed_step_index
    feedback.currently_executing_step_index = status.executing_step_index
    feedback.first_changeable_step_index = status.first_changeable_step_index
    return feedback
