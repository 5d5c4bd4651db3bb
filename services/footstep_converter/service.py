"""The loop: goals of the action in, plans out to the Motion Manager, and its words about them back.

At most one plan runs, and at most one request to the Motion Manager is open. A goal that comes while a plan runs
updates it from the goal's first step on, or stops it if it has no steps (vigir_step_control's rules).
"""

from __future__ import annotations

import logging
import time
from concurrent.futures import Future
from dataclasses import dataclass

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from vigir_footstep_planning_msgs.msg import ErrorStatus, FootstepExecutionStatus

import bifrost
from footstep_converter.action import Goal, StepPlanAction
from footstep_converter.execution import End, Execution, Outcome, aborted, refusal
from footstep_converter.motion_system import ANSWER, MotionSystem
from footstep_converter.plan import PlanError, convert
from valor_common.messages import Footstep, FootstepPlanReply
from valor_common.service import Context
from valor_common.topics import FOOTSTEP_PLAN

IDLE_PERIOD = 0.25  # between looks at the clock without a plan [s]
ACTIVE_PERIOD = 0.02  # between looks at the Motion Manager with one [s]
FEEDBACK_PERIOD = 0.1  # [s]
STOP_RETRY = 0.5  # from a stop that was not answered to the next [s]

_F = FootstepExecutionStatus
_log = logging.getLogger("footstep_converter")


@dataclass
class _Handover:
    """A plan on its way to the Motion Manager."""

    goal: Goal
    steps: list[Footstep]  # none: stop
    reply: Future[FootstepPlanReply]


class FootstepConverter:
    """Serves ExecuteStepPlan on behalf of the Motion Manager."""

    def __init__(self, context: Context) -> None:
        self._stopping = context.stopping
        self._statistics = context.statistics
        self._robot = context.robot
        self._motion = MotionSystem(context.node)
        self._ros = rclpy.Context()
        rclpy.init(
            context=self._ros,
            domain_id=context.settings.ros_domain_id,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self._executor = SingleThreadedExecutor(context=self._ros)
        self._node = rclpy.create_node("footstep_converter", context=self._ros, enable_rosout=False)
        self._executor.add_node(self._node)
        self._action = StepPlanAction(self._node, self._executor, self._begin, self._cancel)

        self._handover: _Handover | None = None
        self._goal: Goal | None = None  # whose plan runs
        self._execution: Execution | None = None
        self._stop: Future[FootstepPlanReply] | None = None  # a stop on its way
        self._stop_wanted = False
        self._next_stop = self._next_feedback = 0.0

    def run(self) -> None:
        """Serve until told to stop."""
        self._statistics.state("ready")
        while not self._stopping.is_set():
            self._turn()
        self._wind_up()

    def close(self) -> None:
        """Leave ROS and Bifrost."""
        self._motion.close()
        self._action.close()
        self._executor.shutdown()
        self._node.destroy_node()
        self._ros.try_shutdown()

    def _turn(self) -> None:
        busy = self._execution is not None or self._handover is not None
        self._executor.spin_once(timeout_sec=ACTIVE_PERIOD if busy else IDLE_PERIOD)
        self._take_answer()
        self._follow()
        self._statistics.drops = self._motion.drops
        self._statistics.idle()

    # --- goals --------------------------------------------------------------------------------------------------

    def _begin(self, goal: Goal) -> None:
        """A new goal: convert its plan and hand it over, or refuse it."""
        if goal.cancel_requested:
            goal.end(Outcome(End.CANCELED, _F.NO_ERROR, ErrorStatus.NO_ERROR, "canceled before it was handed over"))
            return
        try:
            steps = self._convert(goal)
        except PlanError as error:
            self._statistics.rejected += 1
            _log.warning("plan refused: %s", error)
            goal.end(Outcome(End.ABORTED, error.status, error.error, str(error)))
            return
        if self._execution is not None and not steps:
            self._execution.stop_asked(time.monotonic())
        self._handover = _Handover(goal, steps, self._motion.request(steps, self._executor.wake))
        goal.progress(None)

    def _convert(self, goal: Goal) -> list[Footstep]:
        if self._handover is not None:
            text = "another plan is being handed to the Motion Manager; send this one again"
            raise PlanError(_F.ERR_CONTROLLER_NOT_READY, ErrorStatus.ERR_INCONSISTENT_REQUEST, text)
        limits = self._robot.tables.footsteps
        if limits is None:
            text = f"robot {self._robot.name!r} takes no footstep plans: its robot.yaml has no footsteps"
            raise PlanError(_F.ERR_CONTROLLER_NOT_READY, ErrorStatus.ERR_INVALID_PARAMETERS, text)
        if self._execution is None:
            return convert(goal.plan, limits)
        if not goal.plan.steps:
            return []
        return convert(goal.plan, limits, self._execution.running_plan)

    def _cancel(self, goal: Goal) -> None:
        """A client no longer wants its plan: once it runs, stop it; on its way, stop it when it is accepted."""
        if goal is self._goal:
            self._stop_wanted = True

    # --- the Motion Manager's answer ------------------------------------------------------------------------------

    def _take_answer(self) -> None:
        """The answer to the plan handed over last, if it has come."""
        handover = self._handover
        if handover is None or not handover.reply.done():
            return
        self._handover = None
        now = time.monotonic()
        refused = self._refused(handover.reply)
        if refused is not None:
            self._statistics.rejected += 1
            _log.warning("plan not taken: %s", refused.text)
            handover.goal.end(refused)
            if self._execution is not None and not handover.steps:
                self._execution.stop_refused()
        elif not handover.steps:
            self._stopped_by(handover.goal)
        elif self._execution is not None:
            self._update(handover, now)
        else:
            self._motion.step_statuses()  # what waits there is about plans before this one
            self._motion.watch(True)
            self._execution = Execution(handover.steps, now)
            self._goal = handover.goal
            _log.info("plan of %d steps accepted", len(handover.steps))
        if self._goal is not None and self._goal.cancel_requested:
            self._stop_wanted = True

    def _refused(self, reply: Future[FootstepPlanReply]) -> Outcome | None:
        """Why the Motion Manager does not execute a plan; None: it does."""
        try:
            answer = reply.result()
        except bifrost.TimeoutError:
            self._stop_wanted = True  # it may yet act on what we have given up
            text = f"the Motion Manager did not answer on {FOOTSTEP_PLAN.name} within {ANSWER:g} s; told it to stop"
            return aborted(_F.ERR_CONTROLLER_NOT_READY, text)
        except bifrost.NoServerError:
            text = f"no Motion Manager: nobody serves {FOOTSTEP_PLAN.name}"
            return aborted(_F.ERR_CONTROLLER_NOT_READY, text)
        except bifrost.Error as error:
            return aborted(_F.ERR_UNKNOWN, f"{FOOTSTEP_PLAN.name}: {error}")
        return None if answer.accepted else refusal(answer.behavior, answer.reason)

    def _stopped_by(self, goal: Goal) -> None:
        """The Motion Manager took the stop that a goal without steps asked for."""
        goal.end(Outcome(End.SUCCEEDED, _F.PREMATURE_HALT, ErrorStatus.NO_ERROR, "the running plan was told to stop"))

    def _update(self, handover: _Handover, now: float) -> None:
        """The Motion Manager took a goal's steps into the running plan: the goal before it has given way."""
        assert self._execution is not None
        assert self._goal is not None
        first = handover.steps[0].step_index
        text = f"a newer plan took over from step {first} on"
        self._goal.end(aborted(_F.UPDATED_STEP_PLAN, text, ErrorStatus.NO_ERROR), self._execution)
        self._execution.update(handover.steps, now)
        self._goal = handover.goal
        _log.info("plan updated from step %d on", first)

    # --- the running plan ---------------------------------------------------------------------------------------

    def _follow(self) -> None:
        """What the Motion Manager says of the running plan; feedback; its end."""
        now = time.monotonic()
        self._send_stop(now)
        execution, goal = self._execution, self._goal
        if execution is None or goal is None:
            return
        if (state := self._motion.behavior()) is not None:
            execution.heard_behavior(state.behavior, state.reason, now)
        for status in self._motion.step_statuses():
            execution.heard_status(status, now)
        execution.passed(now)
        if execution.outcome is not None:
            self._end(execution, goal, execution.outcome)
        elif now >= self._next_feedback:
            self._next_feedback = now + FEEDBACK_PERIOD
            goal.progress(execution)

    def _end(self, execution: Execution, goal: Goal, outcome: Outcome) -> None:
        _log.info("plan %s after %d steps: %s", outcome.end.value, len(execution.plan), outcome.text or "goal reached")
        self._stop_wanted = outcome.unconfirmed  # a plan that we no longer follow must not go on unseen
        goal.end(outcome, execution)
        self._execution = self._goal = None
        self._motion.watch(False)

    def _send_stop(self, now: float) -> None:
        """Tell the Motion Manager to stop, until it answers or there is nothing left to stop."""
        if self._stop is not None and self._stop.done():
            self._stop_answered(self._stop, now)
            self._stop = None
        if self._stop_wanted and self._stop is None and now >= self._next_stop:
            self._stop_wanted = False
            self._stop = self._motion.request([], self._executor.wake)
            if self._execution is not None:
                self._execution.stop_asked(now)

    def _stop_answered(self, stop: Future[FootstepPlanReply], now: float) -> None:
        try:
            answer = stop.result()
        except bifrost.Error as error:
            _log.warning("stop: %s", error)
            self._stop_wanted = self._execution is not None
            self._next_stop = now + STOP_RETRY
            return
        if answer.accepted:
            _log.info("the Motion Manager stops")
        else:
            _log.warning("the Motion Manager does not stop: %s", answer.reason)
            if self._execution is not None:
                self._execution.stop_refused()

    def _wind_up(self) -> None:
        """Told to stop in mid-plan: nobody would follow it, so it stops too, and its client hears why."""
        if not self._action.open_goals:
            return
        stop = self._motion.request([], self._executor.wake)
        text = "the footstep converter is stopping; the plan was told to stop"
        for goal in self._action.open_goals:
            goal.end(aborted(_F.PREMATURE_HALT | _F.ERR_CONTROLLER_NOT_READY, text))
        deadline = time.monotonic() + ANSWER
        while (self._action.open_goals or not stop.done()) and time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=ACTIVE_PERIOD)
