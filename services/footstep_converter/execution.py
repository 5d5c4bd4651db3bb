"""One plan from the moment it is handed to the Motion Manager until its end, and how it ended.

Nothing here knows ROS or sockets: what is heard goes in with the time [s] at which it was heard, the outcome comes out.
How long the robot may take for something is counted in its own time, which goes by slowly in a slow simulation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from vigir_footstep_planning_msgs.msg import ErrorStatus, FootstepExecutionStatus

from valor.common.behaviors import FALLEN, STANDING, STEPPING, STOPPED
from valor.common.messages import StepStatus
from valor.footstep_converter.plan import PlannedStep, RunningPlan

SILENCE = 4.0  # without a word of the Motion Manager, it is lost [s]
START = 2.0  # from acceptance to the first word of steps being taken [robot time, s]
SETTLE = 1.0  # in Stand, from the last word of steps being taken to the last word about the plan [robot time, s]
STOP = 20.0  # from a stop request to the end: the swing foot comes down and the robot settles [robot time, s]

_F = FootstepExecutionStatus
_PREMATURE = _F.PREMATURE_HALT
# What it means for a plan that the robot is in a behavior that is neither Step nor Stand.
_LEFT_FOR: Mapping[str, int] = {
    **dict.fromkeys(FALLEN, _F.ERR_FALLEN | _F.EMERGENCY_HALT),
    **dict.fromkeys(STOPPED, _F.EMERGENCY_HALT),
}
_WRONG_BEHAVIOR = _F.ERR_INVALID_BEHAVIOR_MODE | _PREMATURE


class End(Enum):
    """The terminal state of the action's goal."""

    SUCCEEDED = "succeeded"
    ABORTED = "aborted"
    CANCELED = "canceled"


@dataclass(frozen=True)
class Outcome:
    """How a plan ended."""

    end: End
    status: int  # flags of FootstepExecutionStatus
    error: int  # flags of ErrorStatus
    text: str
    unconfirmed: bool = False  # ended without the Motion Manager's word: the robot may still step


def aborted(status: int, text: str, error: int = ErrorStatus.ERR_UNKNOWN) -> Outcome:
    """A plan that did not reach its goal, and why."""
    return Outcome(End.ABORTED, status, error, text)


def refusal(behavior: str, reason: str) -> Outcome:
    """What the Motion Manager's refusal means: its own words, and the flag for the behavior it is in."""
    if behavior in STEPPING:
        return aborted(_F.ERR_CONTROLLER_NOT_READY, reason, ErrorStatus.ERR_NO_SOLUTION)
    halt = _LEFT_FOR.get(behavior, 0) & _F.ERR_FALLEN
    return aborted(_F.ERR_INVALID_BEHAVIOR_MODE | halt, reason)


@dataclass(frozen=True)
class Progress:
    """Where a plan is. While it runs no index goes back, and performed ≤ executing < changeable."""

    time: int  # robot time [ns]
    queue_size: int
    performed: int  # index of the last step done; before the first: one less than the plan's first
    executing: int  # of the step being taken; of the last one done, between the last step and rest
    changeable: int  # of the first step that can still be changed, at most one behind the last

    @property
    def indices(self) -> tuple[int, int, int]:
        """Performed, executing, changeable."""
        return self.performed, self.executing, self.changeable


class Execution:
    """Follows a plan that the Motion Manager accepted.

    Attributes:
        plan: the steps as accepted, updates included.
        status: the Motion Manager's last word about this plan, None before the first.
        progress: what is known of where the plan is.
        outcome: how it ended, None while it runs.
    """

    def __init__(self, plan: Sequence[PlannedStep], now: float) -> None:
        self.plan = list(plan)
        self.status: StepStatus | None = None
        first = self.plan[0].index
        self.progress = Progress(0, len(self.plan), first - 1, first - 1, first)
        self.outcome: Outcome | None = None
        self._heard = now
        self._heard_since: int | None = None  # robot time heard first [ns]
        self._stepped = 0  # robot time at which the Motion Manager is known to have stepped last [ns]; 0: not yet
        self._time = 0  # robot time heard last [ns]
        self._stood_since: int | None = None  # in Stand, having stepped, since the last word of steps being taken
        self._recalled = False  # steps were still being taken in Stand: somebody has changed the behavior
        self._stop_asked: float | None = None
        self._stop_since: int | None = None  # robot time heard first after that [ns]
        self._behavior = self._reason = ""

    @property
    def last_index(self) -> int:
        """Index of the plan's last step."""
        return self.plan[-1].index

    @property
    def stopping(self) -> bool:
        """Whether it has been told to stop."""
        return self._stop_asked is not None

    @property
    def running_plan(self) -> RunningPlan:
        """What an update may change."""
        changeable = self.status.first_changeable_step_index if self.status else self.plan[0].index
        return RunningPlan(self.plan, changeable)

    def update(self, plan: Sequence[PlannedStep]) -> None:
        """The Motion Manager accepted other steps from ``plan[0]`` on."""
        self.plan = self.running_plan.updated(plan)

    def stop_asked(self, now: float) -> None:
        """The Motion Manager is being told to stop."""
        self._stop_asked = self._stop_asked or now

    def stop_refused(self) -> None:
        """The Motion Manager goes on."""
        self._stop_asked = self._stop_since = None

    def heard_status(self, status: StepStatus, now: float) -> None:
        """A StepStatus. Before this plan executes, it may still be about the one before it."""
        self._hear(now, status.time)
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

    def _hear(self, now: float, time: int) -> None:
        self._heard, self._time = now, max(self._time, time)
        if self._heard_since is None:
            self._heard_since = self._time
        if self._stop_asked is not None and self._stop_since is None:
            self._stop_since = self._time

    def _advance(self, status: StepStatus) -> None:
        self.status = status
        before = self.progress
        performed = max(before.performed, status.last_performed_step_index)
        executing = max(before.executing, status.executing_step_index, performed)
        changeable = max(before.changeable, status.first_changeable_step_index, executing + 1)
        self.progress = Progress(status.time, status.queue_size, performed, executing, changeable)

    def _ended(self, status: StepStatus) -> None:
        # A plan that was told to end has a reason, however many steps it took.
        if status.state == "finished" and not status.reason and status.last_performed_step_index == self.last_index:
            self.outcome = Outcome(End.SUCCEEDED, _F.REACHED_GOAL, ErrorStatus.NO_ERROR, "")
            return
        done, last = status.last_performed_step_index, self.last_index
        text = f"the Motion Manager reports {status.state!r} after step {done} of {last}"
        if status.reason:
            text += f": {status.reason}"
        if self._stop_asked is not None:
            self.outcome = Outcome(End.CANCELED, _PREMATURE, ErrorStatus.NO_ERROR, text)
        elif self._recalled:
            self.outcome = aborted(_WRONG_BEHAVIOR, text)
        else:
            self.outcome = aborted(_LEFT_FOR.get(self._behavior, _F.ERR_UNKNOWN | _PREMATURE), text)

    def heard_behavior(self, behavior: str, reason: str, now: float, time: int) -> None:
        """The behavior that the Motion Manager is in at robot time ``time`` [ns], and why it went there."""
        self._hear(now, time)
        self._behavior, self._reason = behavior, reason
        if self.outcome is not None:
            return
        if behavior in STEPPING:
            self._stepped, self._stood_since = max(self._stepped, time), None
        elif behavior in STANDING:
            # Between two looks Step may have come and gone; what was said of Stand before it is old.
            if self._stepped and time > self._stepped and self._stood_since is None:
                self._stood_since = time
        else:
            flags = _LEFT_FOR.get(behavior, _WRONG_BEHAVIOR)
            self.outcome = aborted(flags, f"the Motion Manager went to {behavior!r}: {reason}")

    def passed(self, now: float) -> None:
        """Time has passed: end what waits for a word that does not come."""
        if self.outcome is not None:
            return
        if now - self._heard > SILENCE:
            flags, text = (
                _F.ERR_CONTROLLER_NOT_READY,
                f"no word of the Motion Manager for {SILENCE:g} s; is it running?",
            )
        elif self._stop_since is not None and self._time - self._stop_since > STOP * 1e9:
            flags, text = _F.ERR_UNKNOWN, f"the Motion Manager did not confirm the stop within {STOP:g} s"
        elif self._stood_since is not None and self._time - self._stood_since > SETTLE * 1e9:
            flags = _F.ERR_INVALID_BEHAVIOR_MODE
            text = f"the Motion Manager went to {self._behavior!r} before the plan's end: {self._reason}"
        elif self.status is None and self._heard_since is not None and self._time - self._heard_since > START * 1e9:
            flags, text = _F.ERR_UNKNOWN, f"accepted, but the Motion Manager reports no step within {START:g} s"
        else:
            return
        self.outcome = Outcome(End.ABORTED, flags | _PREMATURE, ErrorStatus.ERR_UNKNOWN, text, unconfirmed=True)
