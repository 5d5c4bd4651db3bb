"""The queue of a footstep plan: the steps to come, the one being taken, and what was done."""

from __future__ import annotations

from collections.abc import Sequence

from motion_manager.whole_body.walking.footsteps import Step
from motion_manager.whole_body.walking.swing import SolePose


class StepQueue:
    """A ``StepSource`` that is filled from outside.

    A step can be changed until it is being taken.

    Attributes:
        steps: queued, the next first.
        executing: the step that is being taken, from the transfer of weight before it until its foot is down, or None.
        last_performed: index of the last step whose foot came down; -1: none.
        state: idle, executing, finished or failed, as in ``StepStatus``.
        reason: of a plan that ended before its last step, or an empty text.
        changes: how often any of these changed.
    """

    def __init__(self) -> None:
        self.steps: list[Step] = []
        self.executing: Step | None = None
        self.last_performed = -1
        self.state = "idle"
        self.reason = ""
        self.changes = 0
        self._just_finished = False

    def take_finished(self) -> bool:
        """Whether a plan has been finished since this was asked last."""
        finished, self._just_finished = self._just_finished, False
        return finished

    def begin(self, steps: Sequence[Step]) -> None:
        """Take a plan; there is none."""
        self.steps = list(steps)
        self.last_performed, self.state, self.reason = -1, "executing", ""
        self.changes += 1

    def update(self, steps: Sequence[Step]) -> None:
        """Other steps from the first one's index on, which is queued."""
        first = steps[0].index
        self.steps = [step for step in self.steps if step.index < first] + list(steps)
        self.changes += 1

    def stop(self, reason: str) -> None:
        """Finish the step that is being taken, and no more."""
        if self.steps:
            self.steps = []
            self.reason = reason
            self.changes += 1

    def fail(self, reason: str) -> None:
        """The plan is over now."""
        if self.state == "executing":
            self.steps, self.executing = [], None
            self.state, self.reason = "failed", reason
            self.changes += 1

    # --- StepSource -----------------------------------------------------------------------------------------------

    def upcoming(self, soles: Sequence[SolePose]) -> Sequence[Step]:
        """The queued steps, wherever the feet are."""
        return self.steps

    def began(self, step: Step) -> None:
        """The first step leaves the queue."""
        self.executing = step
        self.steps = self.steps[1:]
        self.changes += 1

    def ended(self, step: Step) -> None:
        """Its foot is down."""
        self.executing, self.last_performed = None, step.index
        self.changes += 1

    def rested(self) -> None:
        """The plan is finished, unless a new one has come meanwhile."""
        if self.state == "executing" and not self.steps:
            self.state, self._just_finished = "finished", True
            self.changes += 1
