"""The queue of a footstep plan: the steps to come, the one being taken, and what was done."""

from __future__ import annotations

from collections.abc import Sequence

from valor.common.messages import StepStatus
from valor.whole_body.walking.footsteps import Step
from valor.whole_body.walking.swing import SolePose


class StepQueue:
    """A ``StepSource`` that is filled from outside.

    A step can be changed until it is being taken. The indices that are reported never go back while a plan runs:
    last performed ≤ executing < first changeable.

    Attributes:
        steps: queued, the next first.
        executing: the step that is being taken, from the transfer of weight before it until its foot is down, or None.
        last: the step whose foot came down last, or None.
        state: idle, executing, finished or failed, as in ``StepStatus``.
        reason: of a plan that ends, or ended, before its last step; or an empty text.
        changes: how often any of these changed.
    """

    def __init__(self) -> None:
        self.steps: list[Step] = []
        self.executing: Step | None = None
        self.last: Step | None = None
        self.state = "idle"
        self.reason = ""
        self.changes = 0
        self._walking = False  # the gait has begun with this plan or the one before, and has not come to rest
        self._just_finished = False

    @property
    def running(self) -> bool:
        """Whether there is a plan, up to the rest after its last step."""
        return self.state == "executing"

    @property
    def stopping(self) -> bool:
        """Whether the plan that runs has been told to end."""
        return self.running and bool(self.reason)

    @property
    def last_performed(self) -> int:
        """Index of the last step whose foot came down; -1: none."""
        return self.last.index if self.last else -1

    @property
    def first_changeable(self) -> int:
        """Index at which a plan may go on otherwise, one behind the last step included; -1: at none."""
        if not self.running or self.stopping:
            return -1
        if self.steps:
            return self.steps[0].index
        return (self.executing.index if self.executing else self.last_performed) + 1

    def status(self, time: int) -> StepStatus:
        """What is being stepped, at robot time ``time`` [ns]."""
        return StepStatus(
            time=time,
            state=self.state,
            reason=self.reason,
            queue_size=len(self.steps),
            last_performed_step_index=self.last_performed,
            executing_step_index=self.executing.index if self.executing else -1,
            first_changeable_step_index=self.first_changeable,
        )

    def take_finished(self) -> bool:
        """Whether a plan has been finished since this was asked last."""
        finished, self._just_finished = self._just_finished, False
        return finished

    def begin(self, steps: Sequence[Step]) -> None:
        """Take a plan; there is none."""
        self.steps = list(steps)
        self.last, self.state, self.reason = None, "executing", ""
        self.changes += 1

    def update(self, steps: Sequence[Step]) -> None:
        """Other steps from the first one's index on, which can still be changed."""
        first = steps[0].index
        self.steps = [step for step in self.steps if step.index < first] + list(steps)
        self.changes += 1

    def stop(self, reason: str, closing: Step | None = None) -> None:
        """Finish the step that is being taken, and take no more but perhaps one that brings the feet together."""
        if not self.steps or self.stopping:
            return
        self.steps = [closing] if closing else []
        self.reason = reason
        self.changes += 1
        if not self._walking:
            self._finish()

    def fail(self, reason: str) -> None:
        """The plan is over now."""
        self._walking = False
        if self.running:
            self.steps, self.executing = [], None
            self.state, self.reason = "failed", reason
            self.changes += 1

    def _finish(self) -> None:
        self.state, self._just_finished = "finished", True
        self.changes += 1

    # --- StepSource -----------------------------------------------------------------------------------------------

    def upcoming(self, soles: Sequence[SolePose]) -> Sequence[Step]:
        """The queued steps, wherever the feet are."""
        return self.steps

    def began(self, step: Step) -> None:
        """The first step leaves the queue."""
        self.executing, self._walking = step, True
        self.steps = self.steps[1:]
        self.changes += 1

    def ended(self, step: Step) -> None:
        """Its foot is down."""
        self.executing, self.last = None, step
        self.changes += 1

    def rested(self) -> None:
        """The plan is finished, unless more steps have come meanwhile."""
        self._walking = False
        if self.running and not self.steps:
            self._finish()
