"""One plan at a time: goals in, a plan to the Motion Manager, and its words about it back to the goal.

At most one plan runs, and at most one request to the Motion Manager is open. A goal that comes while a plan runs
updates it from the first step that can still be changed, or stops it if it has no steps (vigir_step_control's rules).
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass

from vigir_footstep_planning_msgs.msg import ErrorStatus, FootstepExecutionStatus, StepPlan

import bifrost
from valor.common.messages import FootstepPlanReply, StepStatus
from valor.common.topics import FOOTSTEP_PLAN
from valor.common.transforms import TooNewError, TransformError
from valor.footstep_converter.clients import Goal
from valor.footstep_converter.execution import End, Execution, Outcome, aborted, refusal
from valor.footstep_converter.frames import Frames
from valor.footstep_converter.motion_system import ANSWER, MotionSystem
from valor.footstep_converter.plan import TERMS, PlanError, PlannedStep, check_size, convert, frame
from valor.footstep_converter.stop import Stop
from valor.robot.description import RobotDescription
from valor.robot.footsteps import StepRule
from valor.service import StatisticsPublisher

FEEDBACK_PERIOD = 0.1  # at most, from one to the next [s]
TRANSFORM_PATIENCE = 1.0  # for a transform as new as a plan's stamp [s]

_F = FootstepExecutionStatus
_log = logging.getLogger("footstep_converter")


@dataclass
class _Waiting:
    """A plan whose frame is not known yet for its time."""

    goal: Goal
    deadline: float  # monotonic [s]


@dataclass
class _Handover:
    """A plan on its way to the Motion Manager."""

    goal: Goal
    steps: list[PlannedStep]
    reply: Future[FootstepPlanReply]


@dataclass
class _Running:
    """The plan that the Motion Manager executes."""

    goal: Goal  # whose it is
    execution: Execution
    next_feedback: float  # monotonic [s]

    def hear(self, statuses: Sequence[StepStatus], now: float) -> None:
        """Take the Motion Manager's words; of a change the client is told at once, so that it hears of every step."""
        for status in statuses:
            told = self.execution.progress.indices
            self.execution.heard_status(status, now)
            if self.execution.outcome is None and self.execution.progress.indices != told:
                self.next_feedback = now + FEEDBACK_PERIOD
                self.goal.progress(self.execution)


class PlanRunner:
    """Takes plans to the Motion Manager and its words about them back. Of one thread."""

    def __init__(
        self,
        robot: RobotDescription,
        motion: MotionSystem,
        frames: Frames,
        statistics: StatisticsPublisher,
        *,
        wake: Callable[[], None],
        refusal: Callable[[], str],
    ) -> None:
        """Without a plan.

        Args:
            robot: its description.
            motion: the Motion Manager.
            frames: where a plan's frame is.
            statistics: of the process: plans refused.
            wake: called, from any thread, when ``turn`` has something to see to.
            refusal: why every plan is refused now; empty: it is not.
        """
        self._robot, self._motion, self._frames, self._statistics = robot, motion, frames, statistics
        self._wake, self._ros_refusal = wake, refusal
        self._waiting: _Waiting | None = None
        self._handover: _Handover | None = None
        self._running: _Running | None = None
        self._taken: StepPlan | None = None  # the plan that the Motion Manager took last, as it came
        self._stop_goals: list[Goal] = []  # that asked for the running plan's end
        self._stop = Stop(motion, wake)

    @property
    def idle(self) -> bool:
        """Whether nothing is under way."""
        return not (self._busy or self._stop.wanted)

    def turn(self) -> None:
        """See to what is new: transforms, the Motion Manager's words, its answers."""
        self._look_again()
        self._follow()
        self._take_answer()

    @property
    def running(self) -> bool:
        """Whether the Motion Manager has a plan of ours, or is being asked to take one."""
        return self._running is not None or self._handover is not None

    @property
    def _execution(self) -> Execution | None:
        return self._running.execution if self._running is not None else None

    def abandon(self, outcome: Outcome) -> Future[FootstepPlanReply]:
        """Have the Motion Manager stop, and tell the client of what runs; returns the answer to come."""
        reply = self._motion.request([], self._wake)
        if self._running is not None:
            self._running.goal.end(outcome, self._running.execution)
        return reply

    # --- goals --------------------------------------------------------------------------------------------------

    def begin(self, goal: Goal) -> None:
        """A new goal: a plan to hand over, or a stop."""
        if refused := self._ros_refusal():
            self._refuse(goal, _not_now(refused))
        elif goal.cancel_requested:
            goal.end(Outcome(End.CANCELED, _F.NO_ERROR, ErrorStatus.NO_ERROR, "canceled before it was handed over"))
        elif not goal.plan.steps and self._busy:
            self._stop_goals.append(goal)
            self._stop.wanted = True
            goal.progress(self._execution)
        else:
            self._take(goal, time.monotonic() + TRANSFORM_PATIENCE)

    @property
    def _busy(self) -> bool:
        """Whether there is a plan to stop."""
        return self.running or self._waiting is not None

    def _take(self, goal: Goal, deadline: float) -> None:
        """Convert a goal's plan and hand it over, refuse it, or wait until ``deadline`` for where its frame is."""
        try:
            steps = self._convert(goal)
        except TooNewError as error:
            if time.monotonic() < deadline:
                self._waiting = _Waiting(goal, deadline)
            else:
                self._refuse(goal, _not_in_odom(f"{error}, and none came within {TRANSFORM_PATIENCE:g} s"))
        except TransformError as error:
            self._refuse(goal, _not_in_odom(str(error)))
        except PlanError as error:
            self._refuse(goal, error)
        else:
            self._handover = _Handover(goal, steps, self._motion.request(steps, self._wake))
            goal.warning = self._repeated(goal)
            goal.waits(steps)

    def _repeated(self, goal: Goal) -> str:
        """What is to be said of a plan that was sent before; empty: nothing."""
        if goal.plan != self._taken:
            return ""
        text = "nothing of it changes" if self._running is not None else "it is walked again"
        _log.warning("the same plan as the one before: %s", text)
        return f"the same plan as the one before: {text}"

    def _refuse(self, goal: Goal, error: PlanError) -> None:
        self._not_taken(goal, aborted(error.status, str(error), error.error))

    def _not_taken(self, goal: Goal, refused: Outcome) -> None:
        self._statistics.rejected += 1
        _log.warning("plan refused: %s", refused.text)
        goal.end(refused)

    def _convert(self, goal: Goal) -> list[PlannedStep]:
        if self._handover is not None or self._waiting is not None:
            raise _not_now("another plan is being handed to the Motion Manager; send this one again")
        execution = self._execution
        if execution is not None and (execution.stopping or self._stop.wanted):
            raise _not_now("the running plan is being stopped; send this one again when the robot stands")
        footsteps = self._robot.tables.footsteps
        if footsteps is None:
            text = f"robot {self._robot.name!r} takes no footstep plans: its robot.yaml has no footsteps"
            raise PlanError(_F.ERR_CONTROLLER_NOT_READY, ErrorStatus.ERR_INVALID_PARAMETERS, text)
        rule, plan = StepRule(footsteps, self._robot.tables.feet, TERMS), goal.plan
        check_size(plan, rule)
        stamp = plan.header.stamp
        to_odom = self._frames.in_odom(frame(plan), stamp.sec * 10**9 + stamp.nanosec)
        return convert(plan, rule, execution.running_plan if execution is not None else None, to_odom)

    def _look_again(self) -> None:
        """Whether the transform that a plan waits for has come."""
        waiting, self._waiting = self._waiting, None
        if waiting is None:
            return
        if waiting.goal.cancel_requested or self._stop.wanted:
            self._stop.wanted = self.running
            waiting.goal.end(Outcome(End.CANCELED, _F.NO_ERROR, ErrorStatus.NO_ERROR, "stopped before it began"))
            if not self._stop.wanted:
                self._end_stop_goals(_STOPPED)
        else:
            self._take(waiting.goal, waiting.deadline)

    def cancel(self, goal: Goal) -> None:
        """A client no longer wants its plan: once it runs, stop it; on its way, stop it when it is accepted."""
        if self._running is not None and goal is self._running.goal:
            self._stop.wanted = True

    # --- the Motion Manager's answer ------------------------------------------------------------------------------

    def _take_answer(self) -> None:
        """The answer to the plan handed over last, if it has come."""
        handover = self._handover
        if handover is None or not handover.reply.done():
            return
        self._handover = None
        now = time.monotonic()
        refused = self._refused(handover.reply)
        if refused is None:
            self._taken = handover.goal.plan
        if refused is not None:
            self._not_taken(handover.goal, refused)
        elif self._running is not None:
            self._update(self._running, handover)
        else:
            self._motion.watch(True)
            self._running = _Running(handover.goal, Execution(handover.steps, now), now)
            self._running.hear(_of_steps_begun(self._motion.step_statuses()), now)
            _log.info("plan of %d steps accepted", len(handover.steps))
        if self._running is None:
            self._end_stop_goals(_STOPPED)
        elif self._running.goal.cancel_requested:
            self._stop.wanted = True

    def _refused(self, reply: Future[FootstepPlanReply]) -> Outcome | None:
        """Why the Motion Manager does not execute a plan; None: it does."""
        try:
            answer = reply.result()
        except bifrost.TimeoutError:
            self._stop.wanted = True  # it may yet act on what we have given up
            text = f"the Motion Manager did not answer on {FOOTSTEP_PLAN.name} within {ANSWER:g} s; told it to stop"
            return aborted(_F.ERR_CONTROLLER_NOT_READY, text)
        except bifrost.NoServerError:
            text = f"no Motion Manager: nobody serves {FOOTSTEP_PLAN.name}"
            return aborted(_F.ERR_CONTROLLER_NOT_READY, text)
        except bifrost.Error as error:
            return aborted(_F.ERR_UNKNOWN, f"{FOOTSTEP_PLAN.name}: {error}")
        return None if answer.accepted else refusal(answer.behavior, answer.reason)

    def _update(self, running: _Running, handover: _Handover) -> None:
        """The Motion Manager took a goal's steps into the running plan: the goal before it has given way."""
        first = handover.steps[0].index
        text = f"a newer plan took over from step {first} on"
        running.goal.end(aborted(_F.UPDATED_STEP_PLAN, text, ErrorStatus.NO_ERROR), running.execution)
        running.execution.update(handover.steps)
        running.goal = handover.goal
        _log.info("plan updated from step %d on", first)

    # --- the running plan ---------------------------------------------------------------------------------------

    def _follow(self) -> None:
        """What the Motion Manager says of the running plan; feedback; its end."""
        now = time.monotonic()
        self._stop.send(self._execution, now, held=self._handover is not None)
        running = self._running
        if running is None:
            if self._handover is None:  # else they may be about it: they wait for the answer
                self._motion.step_statuses()
            return
        execution = running.execution
        if (state := self._motion.behavior()) is not None:
            execution.heard_behavior(state.behavior, state.reason, now, state.time)
        running.hear(self._motion.step_statuses(), now)
        execution.passed(now)
        if execution.outcome is not None:
            self._end(running, execution.outcome)
        elif now >= running.next_feedback:
            running.next_feedback = max(running.next_feedback + FEEDBACK_PERIOD, now)
            running.goal.progress(execution)

    def _end(self, running: _Running, outcome: Outcome) -> None:
        steps = len(running.execution.plan)
        _log.info("plan %s after %d steps: %s", outcome.end.value, steps, outcome.text or "goal reached")
        self._stop.wanted = outcome.unconfirmed  # a plan that we no longer follow must not go on unseen
        running.goal.end(outcome, running.execution)
        self._end_stop_goals(outcome if outcome.end is End.ABORTED else _STOPPED)
        self._running = None
        self._motion.watch(False)

    def _end_stop_goals(self, outcome: Outcome) -> None:
        """What was to be stopped has ended."""
        for goal in self._stop_goals:
            goal.end(outcome)
        self._stop_goals = []


def _of_steps_begun(statuses: Sequence[StepStatus]) -> Sequence[StepStatus]:
    """Without what is said up to the end of the plan before."""
    ends = (at for at in range(len(statuses), 0, -1) if statuses[at - 1].state != "executing")
    return statuses[next(ends, 0) :]


_STOPPED = Outcome(End.SUCCEEDED, _F.PREMATURE_HALT, ErrorStatus.NO_ERROR, "the running plan has ended")


def _not_now(text: str) -> PlanError:
    return PlanError(_F.ERR_CONTROLLER_NOT_READY, ErrorStatus.ERR_INCONSISTENT_REQUEST, text)


def _not_in_odom(text: str) -> PlanError:
    return PlanError(
        _F.ERR_INCONSISTENT_STEP_PLAN, ErrorStatus.ERR_INVALID_PARAMETERS, f"the plan cannot be put in odom: {text}"
    )
