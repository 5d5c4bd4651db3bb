"""What clients are told of a plan."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from builtin_interfaces.msg import Time
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_footstep_planning_msgs.msg import ErrorStatus, FootstepExecutionStatus, Step

from valor.footstep_converter.execution import End, Execution, Outcome
from valor.footstep_converter.plan import PlannedStep


class FeedbackMaker:
    """Makes feedback messages; the plan's steps are made anew only when they change.

    Attributes:
        frame: odom, as tf names it.
    """

    def __init__(self, now: Callable[[], int], frame: str) -> None:
        """``now``: gives robot time [ns]."""
        self._now = now
        self.frame = frame
        self._plan: list[PlannedStep] = []
        self._steps: list[Step] = []

    def waiting(self, steps: Sequence[PlannedStep]) -> ExecuteStepPlan.Feedback:
        """Of steps that are being handed over: none has been begun, all can be changed."""
        feedback = self.progress(None)
        feedback.queue_size = len(steps)
        if steps:
            first, last = steps[0].index, steps[-1].index
            feedback.first_queued_step_index, feedback.last_queued_step_index = first, last
            feedback.last_performed_step_index = feedback.currently_executing_step_index = first - 1
            feedback.first_changeable_step_index = first
        return feedback

    def progress(self, execution: Execution | None) -> ExecuteStepPlan.Feedback:
        """Where a plan is; None: it is not known, or none is followed."""
        feedback = ExecuteStepPlan.Feedback()
        feedback.header.frame_id = feedback.feedback.header.frame_id = self.frame
        feedback.first_queued_step_index = feedback.last_queued_step_index = -1
        feedback.last_performed_step_index = -1
        feedback.currently_executing_step_index = -1
        feedback.first_changeable_step_index = -1
        time = self._now() if execution is None else execution.progress.time
        feedback.header.stamp = feedback.feedback.header.stamp = Time(sec=time // 10**9, nanosec=time % 10**9)
        if execution is None:
            feedback.controller_state = int(ExecuteStepPlan.Feedback.READY)
            feedback.stepping_status = int(FootstepExecutionStatus.WAITING_FOR_ATLAS)
            return feedback
        progress = execution.progress
        feedback.controller_state = int(ExecuteStepPlan.Feedback.ACTIVE)
        feedback.stepping_status = int(FootstepExecutionStatus.EXECUTING_STEP_PLAN)
        feedback.queue_size = progress.queue_size
        if progress.queue_size > 0:
            feedback.first_queued_step_index = execution.last_index - progress.queue_size + 1
            feedback.last_queued_step_index = execution.last_index
        feedback.last_performed_step_index = progress.performed
        feedback.currently_executing_step_index = progress.executing
        feedback.first_changeable_step_index = progress.changeable
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
            self._plan, self._steps = list(plan), [_message(step, self.frame) for step in plan]
        return self._steps


def warn(feedback: ExecuteStepPlan.Feedback, text: str) -> ExecuteStepPlan.Feedback:
    """It, with a warning; empty: none."""
    if text:
        feedback.status.warning, feedback.status.warning_msg = ErrorStatus.WARN_UNKNOWN, text
    return feedback


def final_state(outcome: Outcome) -> int:
    """FINISHED or FAILED."""
    feedback = ExecuteStepPlan.Feedback
    return int(feedback.FINISHED if outcome.end is End.SUCCEEDED else feedback.FAILED)


def _message(planned: PlannedStep, frame: str) -> Step:
    """A step as the feedback shows it."""
    step = Step(step_index=planned.index, valid=True)
    step.header.frame_id = step.foot.header.frame_id = frame
    step.foot.foot_index = planned.foot
    p, q = step.foot.pose.position, step.foot.pose.orientation
    p.x, p.y, p.z = planned.sole.position
    q.w, q.x, q.y, q.z = planned.sole.orientation
    step.swing_height = planned.swing_height
    step.step_duration, step.sway_duration = planned.swing_duration, planned.transfer_duration
    return step
