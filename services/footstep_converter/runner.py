"""Runs one plan at a time: from goals to the Motion Manager, and its reports back to the goal.

At most one plan runs, and at most one request is open. A goal received while a plan runs updates it from the first step
that can still be changed, or stops it if it has no steps (vigir_step_control's rules).
"""

import logging
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass

from vigir_footstep_planning_msgs.msg import ErrorStatus, FootstepExecutionStatus

import bifrost
from valor.common.messages import FootstepPlanReply, StepStatus
from valor.common.topics import FOOTSTEP_PLAN
from valor.common.transforms import TooNewError, TransformError
from valor.footstep_converter.clients import Frames, PlanGoal
from valor.footstep_converter.execution import End, Execution, PlanOutcome, aborted, rejected
from valor.footstep_converter.motion_system import ANSWER, MotionSystem
from valor.footstep_converter.plan import TERMS, PlannedStep, PlanRejectedError, check_size, convert, frame, stamp
from valor.robot.description import RobotDescription
from valor.robot.footsteps import StepRule
from valor.service import StatisticsPublisher

FEEDBACK_PERIOD = 0.1  # [s]
TRANSFORM_TIMEOUT = 1.0  # for a transform as new as a plan's stamp [s]
RETRY = 0.5  # of a stop without reply [s]

_F = FootstepExecutionStatus
_log = logging.getLogger("footstep_converter")


@dataclass
class _Request:
    """Plan sent to the Motion Manager."""

    goal: PlanGoal
    steps: list[PlannedStep]
    reply: Future[FootstepPlanReply]


@dataclass
class _Running:
    """Plan that the Motion Manager executes."""

    goal: PlanGoal
    execution: Execution
    next_feedback: float  # monotonic [s]

    def add(self, statuses: Sequence[StepStatus], now: float) -> None:
        """Process reports; a change is sent as feedback at once, so that the client receives every step."""
        for status in statuses:
            before = self.execution.progress.indices
            self.execution.add_status(status, now)
            if self.execution.outcome is None and self.execution.progress.indices != before:
                self.next_feedback = now + FEEDBACK_PERIOD
                self.goal.report_progress(self.execution)


class PlanRunner:
    """Sends plans to the Motion Manager and reports to the clients. Not thread-safe.

    A stop is requested again until the Motion Manager replies or no plan runs; it waits for the reply to a plan.
    """

    def __init__(
        self,
        robot: RobotDescription,
        motion: MotionSystem,
        frames: Frames,
        statistics: StatisticsPublisher,
        *,
        wake: Callable[[], None],
        rejection: Callable[[], str],
    ) -> None:
        """Start without a plan.

        ``wake``: called from any thread when ``turn`` has pending work; ``rejection``: returns the reason to reject
        every plan now, empty if there is none.
        """
        self._robot, self._motion, self._frames, self._statistics = robot, motion, frames, statistics
        self._wake, self._rejection = wake, rejection
        self._waiting: tuple[PlanGoal, float] | None = None  # for a transform, until a monotonic time [s]
        self._request: _Request | None = None
        self._running: _Running | None = None
        self._stop_goals: list[PlanGoal] = []
        self._stop_requested = False  # to be sent, not before the time below [monotonic, s]
        self._next_stop = 0.0
        self._stop_reply: Future[FootstepPlanReply] | None = None

    @property
    def idle(self) -> bool:
        """True if there is no plan and no stop request."""
        return not (self._busy or self._stop_requested)

    def turn(self) -> None:
        """Process one cycle: transforms, reports, replies."""
        self._retry_waiting()
        self._follow()
        self._process_reply()

    @property
    def running(self) -> bool:
        return self._running is not None or self._request is not None

    @property
    def _execution(self) -> Execution | None:
        return self._running.execution if self._running is not None else None

    def abandon(self, outcome: PlanOutcome) -> Future[FootstepPlanReply]:
        """Request a stop and end the running goal; returns the future reply."""
        reply = self._motion.request([], self._wake)
        if self._running is not None:
            self._running.goal.end(outcome, self._running.execution)
        return reply

    def begin(self, goal: PlanGoal) -> None:
        """Process a new goal: a plan, or a stop."""
        if reason := self._rejection():
            self._reject(goal, _not_now(reason))
        elif not goal.plan.steps and self._busy:
            self._stop_goals.append(goal)
            self._stop_requested = True
            goal.report_progress(self._execution)
        else:
            self._send(goal, time.monotonic() + TRANSFORM_TIMEOUT)

    @property
    def _busy(self) -> bool:
        return self.running or self._waiting is not None

    def _send(self, goal: PlanGoal, deadline: float) -> None:
        """Convert a goal's plan and send it, reject it, or wait until ``deadline`` for its transform."""
        try:
            steps = self._convert(goal)
        except TooNewError as error:
            if time.monotonic() < deadline:
                self._waiting = goal, deadline
            else:
                self._reject(goal, _not_in_odom(f"{error}, and none was received within {TRANSFORM_TIMEOUT:g} s"))
        except TransformError as error:
            self._reject(goal, _not_in_odom(str(error)))
        except PlanRejectedError as error:
            self._reject(goal, error)
        else:
            self._request = _Request(goal, steps, self._motion.request(steps, self._wake))
            goal.report_waiting(steps)

    def _reject(self, goal: PlanGoal, error: PlanRejectedError | PlanOutcome) -> None:
        if isinstance(error, PlanRejectedError):
            error = aborted(error.status, str(error), error.error)
        self._statistics.rejected += 1
        _log.warning("plan rejected: %s", error.text)
        goal.end(error)

    def _convert(self, goal: PlanGoal) -> list[PlannedStep]:
        if self._request is not None or self._waiting is not None:
            raise _not_now("another plan is being sent to the Motion Manager; send this one again")
        execution = self._execution
        if execution is not None and (execution.stopping or self._stop_requested):
            raise _not_now("the running plan is being stopped; send this one again when the robot stands")
        footsteps = self._robot.tables.footsteps
        if footsteps is None:
            text = f"robot {self._robot.name!r} accepts no footstep plans: its robot.yaml has no table footsteps"
            raise PlanRejectedError(_F.ERR_CONTROLLER_NOT_READY, ErrorStatus.ERR_INVALID_PARAMETERS, text)
        rule, plan = StepRule(footsteps, self._robot.tables.feet, TERMS), goal.plan
        check_size(plan, rule)
        to_odom = self._frames.in_odom(frame(plan), stamp(plan, self._motion.time))
        return convert(plan, rule, execution.running_plan if execution is not None else None, to_odom)

    def _retry_waiting(self) -> None:
        """Send the waiting plan if its transform has been received."""
        waiting, self._waiting = self._waiting, None
        if waiting is None:
            return
        goal, deadline = waiting
        if goal.cancel_requested or self._stop_requested:
            self._stop_requested = self.running
            goal.end(PlanOutcome(End.CANCELED, _F.NO_ERROR, ErrorStatus.NO_ERROR, "stopped before it started"))
            if not self._stop_requested:
                self._end_stop_goals(_STOPPED)
        else:
            self._send(goal, deadline)

    def cancel(self, goal: PlanGoal) -> None:
        """Stop a goal's running plan; a plan being sent stops after acceptance."""
        if self._running is not None and goal is self._running.goal:
            self._stop_requested = True

    def _process_reply(self) -> None:
        """Process the reply to the open plan request, if received."""
        request = self._request
        if request is None or not request.reply.done():
            return
        self._request = None
        now = time.monotonic()
        if (outcome := self._failure(request.reply)) is not None:
            self._reject(request.goal, outcome)
        elif self._running is not None:
            self._update(self._running, request)
        else:
            self._motion.watch(True)
            self._running = _Running(request.goal, Execution(request.steps, now), now)
            self._running.add(_of_current_plan(self._motion.step_statuses()), now)
            _log.info("plan of %d steps accepted", len(request.steps))
        if self._running is None:
            self._end_stop_goals(_STOPPED)
        elif self._running.goal.cancel_requested:
            self._stop_requested = True

    def _failure(self, reply: Future[FootstepPlanReply]) -> PlanOutcome | None:
        """Outcome of a plan that the Motion Manager does not execute; None if it does."""
        try:
            answer = reply.result()
        except bifrost.TimeoutError:
            self._stop_requested = True  # the Motion Manager may still execute the plan
            text = f"no reply of the Motion Manager on {FOOTSTEP_PLAN.name} within {ANSWER:g} s; requested a stop"
            return aborted(_F.ERR_CONTROLLER_NOT_READY, text)
        except bifrost.NoServerError:
            text = f"no Motion Manager: no process serves {FOOTSTEP_PLAN.name}"
            return aborted(_F.ERR_CONTROLLER_NOT_READY, text)
        except bifrost.Error as error:
            return aborted(_F.ERR_UNKNOWN, f"{FOOTSTEP_PLAN.name}: {error}")
        return None if answer.accepted else rejected(answer.behavior, answer.reason)

    def _update(self, running: _Running, request: _Request) -> None:
        """Replace the running goal after acceptance of its update."""
        first = request.steps[0].index
        text = f"a newer plan replaced it from step {first} on"
        running.goal.end(aborted(_F.UPDATED_STEP_PLAN, text, ErrorStatus.NO_ERROR), running.execution)
        running.execution.update(request.steps)
        running.goal = request.goal
        _log.info("plan updated from step %d on", first)

    def _send_stop(self, now: float) -> None:
        """Request a stop if that is needed; ``now``: monotonic [s]."""
        execution = self._execution
        if self._stop_reply is not None and self._stop_reply.done():
            reply, self._stop_reply = self._stop_reply, None
            try:
                answer = reply.result()
            except bifrost.Error as error:
                _log.warning("stop: %s", error)
                self._stop_requested = execution is not None
                self._next_stop = now + RETRY
            else:
                if answer.accepted:
                    _log.info("the Motion Manager stops")
                else:
                    _log.warning("the Motion Manager rejected the stop: %s", answer.reason)
                    if execution is not None:
                        execution.reject_stop()
        if self._stop_requested and self._stop_reply is None and self._request is None and now >= self._next_stop:
            self._stop_requested = False
            self._stop_reply = self._motion.request([], self._wake)
            if execution is not None:
                execution.request_stop(now)

    def _follow(self) -> None:
        """Process reports on the running plan; send feedback; detect its end."""
        now = time.monotonic()
        self._send_stop(now)
        running = self._running
        if running is None:
            if self._request is None:  # else the statuses may be of its plan: they wait for the reply
                self._motion.step_statuses()
            return
        execution = running.execution
        if (state := self._motion.behavior()) is not None:
            execution.add_behavior(state.behavior, state.reason, now, state.time)
        running.add(self._motion.step_statuses(), now)
        execution.check_timeouts(now)
        if execution.outcome is not None:
            self._end(running, execution.outcome)
        elif now >= running.next_feedback:
            running.next_feedback = max(running.next_feedback + FEEDBACK_PERIOD, now)
            running.goal.report_progress(execution)

    def _end(self, running: _Running, outcome: PlanOutcome) -> None:
        steps = len(running.execution.plan)
        _log.info("plan %s after %d steps: %s", outcome.end.value, steps, outcome.text or "goal reached")
        self._stop_requested = outcome.unconfirmed  # a plan must not continue unattended
        running.goal.end(outcome, running.execution)
        self._end_stop_goals(outcome if outcome.end is End.ABORTED else _STOPPED)
        self._running = None
        self._motion.watch(False)

    def _end_stop_goals(self, outcome: PlanOutcome) -> None:
        for goal in self._stop_goals:
            goal.end(outcome)
        self._stop_goals = []


def _of_current_plan(statuses: Sequence[StepStatus]) -> Sequence[StepStatus]:
    """Statuses after the end of the previous plan."""
    ends = (i for i in range(len(statuses), 0, -1) if statuses[i - 1].state != "executing")
    return statuses[next(ends, 0) :]


_STOPPED = PlanOutcome(End.SUCCEEDED, _F.PREMATURE_HALT, ErrorStatus.NO_ERROR, "the running plan has ended")


def _not_now(text: str) -> PlanRejectedError:
    return PlanRejectedError(_F.ERR_CONTROLLER_NOT_READY, ErrorStatus.ERR_INCONSISTENT_REQUEST, text)


def _not_in_odom(text: str) -> PlanRejectedError:
    text = f"the plan cannot be transformed to odom: {text}"
    return PlanRejectedError(_F.ERR_INCONSISTENT_STEP_PLAN, ErrorStatus.ERR_INVALID_PARAMETERS, text)
