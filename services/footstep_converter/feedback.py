"""What clients are told of a plan."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_footstep_planning_msgs.msg import FootstepExecutionStatus, Step

from valor.footstep_converter.execution import End, Execution, Outcome
from valor.footstep_converter.frames import ODOM
from valor.footstep_converter.plan import PlannedStep


class FeedbackMaker:
    """Makes feedback messages; the plan's steps are made anew only when they change."""

    def __init__(self) -> None:
        self._plan: list[PlannedStep] = []
        self._steps: list[Step] = []

    def progress(self, execution: Execution | None) -> ExecuteStepPlan.Feedback:
        """Where a plan is; None: it is being handed over."""
        feedback = ExecuteStepPlan.Feedback()
        feedback.header.frame_id = feedback.feedback.header.frame_id = ODOM
        feedback.first_queued_step_index = feedback.last_queued_step_index = -1
        feedback.last_performed_step_index = -1
        feedback.currently_executing_step_index = -1
        feedback.first_changeable_step_index = -1
        if execution is None:
            feedback.controller_state = int(ExecuteStepPlan.Feedback.READY)
            feedback.stepping_status = int(FootstepExecutionStatus.WAITING_FOR_ATLAS)
            return feedback
        progress = execution.progress
        feedback.header.stamp = Time(sec=progress.time // 10**9, nanosec=progress.time % 10**9)
        feedback.controller_state = int(ExecuteStepPlan.Feedback.ACTIVE)
        feedback.stepping_status = int(FootstepExecutionStatus.EXECUTING_STEP_PLAN)
        feedback.queue_size = progress.queue_size
        if progress.queue_size > 0:
            feedback.first_queued_step_index = execution.last_index - progress.queue_size + 1
            feedback.last_queued_step_index = execution.last_index
        feedback.last_performed_step_index = progress.performed
        feedback.currently_executing_step_index = progress.executing
        feedback.first_changeable_step_index = progress.changeable
        feedback.feedback.header.stamp = feedback.header.stamp
        feedback.feedback.steps = self._steps_of(execution.plan)
        return feedback

    def end(self, outcome: Outcome, execution: Execution | None) -> ExecuteStepPlan.Feedback:
        """How a plan ended. The result has no text: the last feedback carries it."""
        feedback = self.progress(execution)
        feedback.controller_state = final_state(outcome)
        feedback.stepping_status = outcome.status
        feedback.status.error = outcome.error
        feedback.status.error_msg = outcome.text
        return feedback

    def _steps_of(self, plan: list[PlannedStep]) -> list[Step]:
        if plan != self._plan:
            self._plan, self._steps = list(plan), [_message(step) for step in plan]
        return self._steps


def final_state(outcome: Outcome) -> int:
    """FINISHED or FAILED."""
    feedback = ExecuteStepPlan.Feedback
    return int(feedback.FINISHED if outcome.end is End.SUCCEEDED else feedback.FAILED)


def _message(planned: PlannedStep) -> Step:
    """A step as the feedback shows it."""
    step = Step(step_index=planned.index, valid=True)
    step.header.frame_id = step.foot.header.frame_id = ODOM
    step.foot.foot_index = planned.foot
    p, q = step.foot.pose.position, step.foot.pose.orientation
    p.x, p.y, p.z = planned.sole.position
    q.w, q.x, q.y, q.z = planned.sole.orientation
    step.swing_height = planned.swing_height
    step.step_duration, step.sway_duration = planned.swing_duration, planned.transfer_duration
    return step
