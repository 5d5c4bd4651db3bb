"""The two-command behavior transition (thesis section 4.2.2, figure 4.3).

A manipulation behavior is entered from its base behavior only, so every control mode is reached by two commands: the
base, and once the Motion System is there, the base again or its manipulation variant. Here stands only what follows
what; asking and listening are the interface's.

The Motion System speaks in two ways, and either may be late: it answers a command with the behavior that it is in
then, and it reports its behavior every period. An answer is enough to go on with the second command; done is what has
been reported.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto

from valor.common.behaviors import Obstacle

REPORT_TIMEOUT = 3.0
"""How long the Motion System may take to report a behavior that it accepted [s]."""
WAIT = 45.0
"""For so long a command is repeated that the Motion System refuses for something that passes by itself [s]."""
AGAIN = 0.1
"""So often [s]."""


@dataclass(frozen=True)
class BehaviorAnswer:
    """What became of one command.

    Attributes:
        number: of the command that is answered.
        accepted: by the Motion Manager.
        reason: why not.
        obstacle: what kind of reason.
        behavior: that the Motion Manager is in; empty: not known.
        silent: no answer came at all.
    """

    number: int
    accepted: bool
    reason: str
    behavior: str = ""
    silent: bool = False
    obstacle: str = Obstacle.NONE


class TransitionState(Enum):
    """How far a transition is."""

    PROCESSING = auto()
    DONE = auto()
    FAILED = auto()


class BehaviorTransition:
    """One pair of commands under way.

    Attributes:
        state: how far it is.
        reason: why it failed.
        obstacle: what kind of refusal it failed for.
        waits_for: what must pass before the present command is accepted; empty: nothing known.
        silent: it failed because nobody answered.
        diverted: it failed because the Motion System went elsewhere on its own.
    """

    def __init__(
        self, commands: tuple[str, str], first_number: int, behavior: str, replaced: BehaviorTransition | None = None
    ) -> None:
        """Prepare to go.

        Args:
            commands: the base behavior, then the base or its variant.
            first_number: the number of the first command; the second has the next.
            behavior: reported now.
            replaced: the transition that this one puts an end to. What it has asked for may still take effect, and
                is no news when it does.
        """
        self.state = TransitionState.PROCESSING
        self.reason = ""
        self.obstacle = Obstacle.NONE
        self.waits_for = ""
        self.silent = False
        self.diverted = False
        self._commands = commands
        self._numbers = (first_number, first_number + 1)
        self._expected: set[str] = {behavior, commands[0]}
        self._in_order = True  # what is reported is not the effect of something asked for before
        if replaced is not None and replaced.state is TransitionState.PROCESSING:
            self._in_order = False
            self._expected |= replaced._expected
        self._step = 0
        self._sent = False
        self._deadline: float | None = None
        self._again: float | None = None  # when to repeat the present command
        self._patience: float | None = None  # until when

    def update(self, now: float, behavior: str, reason: str, answer: BehaviorAnswer | None) -> tuple[int, str] | None:
        """Take in what is new; returns the number and the name of a behavior to ask for now, if any.

        Args:
            now: monotonic [s].
            behavior: reported by the Motion System.
            reason: of its last change of behavior.
            answer: to a command, if one came; answers to other transitions' commands are ignored.
        """
        if self.state is not TransitionState.PROCESSING:
            return None
        command = self._commands[self._step]
        if behavior not in self._expected:
            self.diverted = True
            self._fail(f"the Motion System went to {behavior}: {reason}")
            return None
        if not self._sent or (self._again is not None and now >= self._again):
            self._sent, self._again = True, None
            return self._numbers[self._step], command
        arrived = behavior == command
        if answer is not None and answer.number == self._numbers[self._step]:
            # A reply that was lost on its way is no refusal, if the Motion System is where it was asked to go.
            if not (answer.accepted or (answer.silent and arrived)):
                self._refused(answer, now)
                return None
            self._deadline = now + REPORT_TIMEOUT
            arrived = arrived or (self._step == 0 and answer.behavior == command)
        if self._deadline is None:
            return None
        if arrived:
            return self._go_on(behavior)
        if now > self._deadline:
            self._fail(
                f"{command} was accepted, but the Motion System still reports {behavior} after {REPORT_TIMEOUT:g} s"
            )
        return None

    def _refused(self, answer: BehaviorAnswer, now: float) -> None:
        """Wait for what passes by itself, and give up otherwise."""
        self._patience = self._patience or now + WAIT
        if answer.obstacle == Obstacle.WAIT and now < self._patience:
            self.waits_for, self._again = answer.reason, now + AGAIN
            return
        self.silent, self.obstacle = answer.silent, Obstacle(answer.obstacle)
        waited = f", for which {WAIT:g} s were waited" if answer.obstacle == Obstacle.WAIT else ""
        self._fail(answer.reason + waited)

    def _go_on(self, behavior: str) -> tuple[int, str] | None:
        """The present command has led where it should."""
        self._deadline = self._patience = None
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
        """Ask for nothing more."""
        if self.state is TransitionState.PROCESSING:
            self.silent = True
            self._fail(reason)

    def _fail(self, reason: str) -> None:
        self.state = TransitionState.FAILED
        self.reason = reason
