"""Two-command behavior transition (thesis section 4.2.2, figure 4.3).

A manipulation behavior is entered only from its base behavior, so every control mode is reached by two commands: the
base, then the base again or its manipulation variant. The Motion System replies to a command with its behavior at that
time, and reports its behavior every period; either may be late. A reply is sufficient for the second command; the
transition is done when the behavior is reported.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto

from valor.common.behaviors import Obstacle

REPORT_TIMEOUT = 3.0  # from acceptance of a behavior to its report [s]
WAIT = 45.0  # longest repetition of a command rejected for a temporary obstacle [s]
RETRY_PERIOD = 0.1  # of the repetition [s]


@dataclass(frozen=True)
class BehaviorAnswer:
    """Reply to one command."""

    number: int  # of the command
    accepted: bool
    reason: str  # of a rejection
    behavior: str = ""  # current one of the Motion Manager; empty: unknown
    silent: bool = False  # no reply was received
    obstacle: str = Obstacle.NONE  # kind of the reason


class TransitionState(Enum):
    """Progress of a transition."""

    PROCESSING = auto()
    DONE = auto()
    FAILED = auto()


class BehaviorTransition:
    """Pair of commands in progress: base behavior, then the base or its variant."""

    def __init__(
        self, commands: tuple[str, str], first_number: int, behavior: str, replaced: BehaviorTransition | None = None
    ) -> None:
        """Prepare the commands, numbered from ``first_number``.

        ``behavior``: currently reported; ``replaced``: transition that this one ends, which may still take effect.
        """
        self.state = TransitionState.PROCESSING  # progress
        self.reason = ""  # of a failure
        self.obstacle = Obstacle.NONE  # its kind
        self.waits_for = ""  # condition for acceptance of the current command; empty: none reported
        self.silent = False  # failed without a reply
        self.diverted = False  # failed because the Motion System entered another behavior
        self._commands = commands
        self._numbers = (first_number, first_number + 1)
        self._expected: set[str] = {behavior, commands[0]}
        self._in_order = True  # the reported behavior cannot result from earlier requests
        if replaced is not None and replaced.state is TransitionState.PROCESSING:
            self._in_order = False
            self._expected |= replaced._expected
        self._step = 0
        self._sent = False
        self._deadline: float | None = None
        self._retry_at: float | None = None  # time to repeat the current command
        self._give_up_at: float | None = None

    def update(self, now: float, behavior: str, reason: str, answer: BehaviorAnswer | None) -> tuple[int, str] | None:
        """Process the latest reports; returns number and name of a behavior to request now, if any.

        Args:
            now: monotonic [s].
            behavior: reported by the Motion System.
            reason: of its last change of behavior.
            answer: if one was received; those to other transitions are ignored.
        """
        if self.state is not TransitionState.PROCESSING:
            return None
        command = self._commands[self._step]
        if behavior not in self._expected:
            self.diverted = True
            self._fail(f"the Motion System entered {behavior}: {reason}")
            return None
        if not self._sent or (self._retry_at is not None and now >= self._retry_at):
            self._sent, self._retry_at = True, None
            return self._numbers[self._step], command
        arrived = behavior == command
        if answer is not None and answer.number == self._numbers[self._step]:
            # A lost reply is no rejection if the Motion System is in the requested behavior.
            if not (answer.accepted or (answer.silent and arrived)):
                self._reject(answer, now)
                return None
            self._deadline = now + REPORT_TIMEOUT
            arrived = arrived or (self._step == 0 and answer.behavior == command)
        if self._deadline is None:
            return None
        if arrived:
            return self._advance(behavior)
        if now > self._deadline:
            self._fail(
                f"{command} was accepted, but the Motion System still reports {behavior} after {REPORT_TIMEOUT:g} s"
            )
        return None

    def _reject(self, answer: BehaviorAnswer, now: float) -> None:
        self._give_up_at = self._give_up_at or now + WAIT
        if answer.obstacle == Obstacle.WAIT and now < self._give_up_at:
            self.waits_for, self._retry_at = answer.reason, now + RETRY_PERIOD
            return
        self.silent, self.obstacle = answer.silent, Obstacle(answer.obstacle)
        waited = f"; not resolved within {WAIT:g} s" if answer.obstacle == Obstacle.WAIT else ""
        self._fail(answer.reason + waited)

    def _advance(self, behavior: str) -> tuple[int, str] | None:
        self._deadline = self._give_up_at = None
        self.waits_for = ""
        if self._step == 1:
            self.state = TransitionState.DONE
            return None
        self._step = 1
        first, second = self._commands
        if self._in_order and behavior == first:
            self._expected = {first}
        self._expected.add(second)
        return self._numbers[1], second

    def abandon(self, reason: str) -> None:
        if self.state is TransitionState.PROCESSING:
            self.silent = True
            self._fail(reason)

    def _fail(self, reason: str) -> None:
        self.state = TransitionState.FAILED
        self.reason = reason
