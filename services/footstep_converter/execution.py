"""Execution of one plan, from acceptance by the Motion Manager to the outcome. Without ROS and sockets.

Reports go in with the time [s] of their receipt. Timeouts of the robot are in robot time, slow in a slow simulation.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from vigir_footstep_planning_msgs.msg import ErrorStatus, FootstepExecutionStatus

from valor.common.behaviors import FALLEN, STANDING, STEPPING, STOPPED
from valor.common.messages import StepStatus
from valor.footstep_converter.plan import PlannedStep, RunningPlan

SILENCE = 4.0  # timeout without messages of the Motion Manager [s]
START = 2.0  # from acceptance to the first report of stepping [robot time, s]
SETTLE = 1.0  # in Stand, from the last report of stepping to the plan's end [robot time, s]
STOP = 20.0  # from a stop request to the end: swing foot down, robot at rest [robot time, s]

_F = FootstepExecutionStatus
_PREMATURE = _F.PREMATURE_HALT
# Flags for a behavior other than Step or Stand.
_LEFT_FOR: Mapping[str, int] = {
    **dict.fromkeys(FALLEN, _F.ERR_FALLEN | _F.EMERGENCY_HALT),
    **dict.fromkeys(STOPPED, _F.EMERGENCY_HALT),
}
_WRONG_BEHAVIOR = _F.ERR_INVALID_BEHAVIOR_MODE | _PREMATURE


class End(Enum):
    """Terminal state of the action's goal."""

    SUCCEEDED = "succeeded"
    ABORTED = "aborted"
    CANCELED = "canceled"


@dataclass(frozen=True)
class PlanOutcome:
    """Outcome of a plan."""

    end: End
    status: int  # flags of FootstepExecutionStatus
    error: int  # flags of ErrorStatus
    text: str
    unconfirmed: bool = False  # not confirmed by the Motion Manager: the robot may still step


def aborted(status: int, text: str, error: int = ErrorStatus.ERR_UNKNOWN) -> PlanOutcome:
    """Outcome of a plan that did not reach its goal."""
    return PlanOutcome(End.ABORTED, status, error, text)


def rejected(behavior: str, reason: str) -> PlanOutcome:
    """Outcome of the Motion Manager's rejection: its reason, and the flag for its behavior."""
    if behavior in STEPPING:
        return aborted(_F.ERR_CONTROLLER_NOT_READY, reason, ErrorStatus.ERR_NO_SOLUTION)
    halt = _LEFT_FOR.get(behavior, 0) & _F.ERR_FALLEN
    return aborted(_F.ERR_INVALID_BEHAVIOR_MODE | halt, reason)


@dataclass(frozen=True)
class Progress:
    """Progress of a plan. While it runs no index decreases, and performed ≤ executing < changeable."""

    time: int  # robot time [ns]
    queue_size: int
    performed: int  # last step done; before the first: one less than the plan's first
    executing: int  # current step; between the last step and rest: the last one
    changeable: int  # first step that can still be changed, at most one after the last

    @property
    def indices(self) -> tuple[int, int, int]:
        """Performed, executing, changeable."""
        return self.performed, self.executing, self.changeable


class Execution:
    """Progress of a plan that the Motion Manager accepted."""

    def __init__(self, plan: Sequence[PlannedStep], now: float) -> None:
        self.plan = list(plan)  # accepted steps, including updates
        self.status: StepStatus | None = None  # the Motion Manager's last one of this plan; None before the first
        first = self.plan[0].index
        self.progress = Progress(0, len(self.plan), first - 1, first - 1, first)  # as reported
        self.outcome: PlanOutcome | None = None  # None while the plan runs
        self._received = now
        self._first_time: int | None = None  # first robot time received [ns]
        self._stepped = 0  # last robot time known to be in Step [ns]; 0: not yet
        self._time = 0  # latest robot time received [ns]
        self._stood_since: int | None = None  # in Stand after stepping, since the last report of stepping
        self._recalled = False  # stepping was reported in Stand: another client changed the behavior
        self._stop_requested: float | None = None
        self._stop_since: int | None = None  # first robot time received after that [ns]
        self._behavior = self._reason = ""

    @property
    def last_index(self) -> int:
        return self.plan[-1].index

    @property
    def stopping(self) -> bool:
        return self._stop_requested is not None

    @property
    def running_plan(self) -> RunningPlan:
        """Plan that an update may change."""
        changeable = self.status.first_changeable_step_index if self.status else self.plan[0].index
        return RunningPlan(self.plan, changeable)

    def update(self, plan: Sequence[PlannedStep]) -> None:
        """Replace the steps from ``plan[0]`` on, after acceptance by the Motion Manager."""
        self.plan = self.running_plan.updated(plan)

    def request_stop(self, now: float) -> None:
        self._stop_requested = self._stop_requested or now

    def reject_stop(self) -> None:
        """Process the Motion Manager's rejection of the stop."""
        self._stop_requested = self._stop_since = None

    def add_status(self, status: StepStatus, now: float) -> None:
        """Process a StepStatus; the first ones may be of the previous plan."""
        self._receive(now, status.time)
        if self.outcome is not None:
            return
        if status.state == "executing":
            self._advance(status)
            self._stepped = max(self._stepped, status.time)
            if self._stood_since is not None and status.time > self._stood_since:
                self._stood_since, self._recalled = status.time, True
        elif self.status is not None:
            self._advance(status)
            self._ended(status)

    def _receive(self, now: float, time: int) -> None:
        self._received, self._time = now, max(self._time, time)
        if self._first_time is None:
            self._first_time = self._time
        if self._stop_requested is not None and self._stop_since is None:
            self._stop_since = self._time

    def _advance(self, status: StepStatus) -> None:
        self.status = status
        before = self.progress
        performed = max(before.performed, status.last_performed_step_index)
        executing = max(before.executing, status.executing_step_index, performed)
        changeable = max(before.changeable, status.first_changeable_step_index, executing + 1)
        self.progress = Progress(status.time, status.queue_size, performed, executing, changeable)

    def _ended(self, status: StepStatus) -> None:
        # A plan that ended early has a reason, regardless of its last step.
        if status.state == "finished" and not status.reason and status.last_performed_step_index == self.last_index:
            self.outcome = PlanOutcome(End.SUCCEEDED, _F.REACHED_GOAL, ErrorStatus.NO_ERROR, "")
            return
        done, last = status.last_performed_step_index, self.last_index
        text = f"the Motion Manager reports {status.state!r} after step {done} of {last}"
        if status.reason:
            text += f": {status.reason}"
        if self._stop_requested is not None:
            self.outcome = PlanOutcome(End.CANCELED, _PREMATURE, ErrorStatus.NO_ERROR, text)
        elif self._recalled:
            self.outcome = aborted(_WRONG_BEHAVIOR, text)
        else:
            self.outcome = aborted(_LEFT_FOR.get(self._behavior, _F.ERR_UNKNOWN | _PREMATURE), text)

    def add_behavior(self, behavior: str, reason: str, now: float, time: int) -> None:
        """Process the Motion Manager's behavior at robot time ``time`` [ns], and the reason of its last change."""
        self._receive(now, time)
        self._behavior, self._reason = behavior, reason
        if self.outcome is not None:
            return
        if behavior in STEPPING:
            self._stepped, self._stood_since = max(self._stepped, time), None
        elif behavior in STANDING:
            # Step may have started and ended between two reports; an older report of Stand is outdated.
            if self._stepped and time > self._stepped and self._stood_since is None:
                self._stood_since = time
        else:
            flags = _LEFT_FOR.get(behavior, _WRONG_BEHAVIOR)
            self.outcome = aborted(flags, f"the Motion Manager entered {behavior!r}: {reason}")

    def check_timeouts(self, now: float) -> None:
        """End the plan after a timeout."""
        if self.outcome is not None:
            return
        if now - self._received > SILENCE:
            flags = _F.ERR_CONTROLLER_NOT_READY
            text = f"no message of the Motion Manager for {SILENCE:g} s; check `valorctl status`"
        elif self._stop_since is not None and self._time - self._stop_since > STOP * 1e9:
            flags, text = _F.ERR_UNKNOWN, f"the Motion Manager did not confirm the stop within {STOP:g} s"
        elif self._stood_since is not None and self._time - self._stood_since > SETTLE * 1e9:
            flags = _F.ERR_INVALID_BEHAVIOR_MODE
            text = f"the Motion Manager entered {self._behavior!r} before the plan's end: {self._reason}"
        elif self.status is None and self._first_time is not None and self._time - self._first_time > START * 1e9:
            flags, text = _F.ERR_UNKNOWN, f"accepted, but the Motion Manager reports no step within {START:g} s"
        else:
            return
        self.outcome = PlanOutcome(End.ABORTED, flags | _PREMATURE, ErrorStatus.ERR_UNKNOWN, text, unconfirmed=True)
