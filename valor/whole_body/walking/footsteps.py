"""Footsteps and their sources."""

from collections.abc import Sequence
from math import hypot, inf

import numpy as np

from valor.common import rotation
from valor.common.messages import StepStatus
from valor.control.steps import SolePose, Step
from valor.control.tuning_tables import Tuning
from valor.robot.description import RobotDescription
from valor.robot.footsteps import LEFT

AHEAD = 3  # automatic steps planned
MOST_MORE = 4  # Steps that bring the DCM between feet side by side: on a slope, or leaning, it may never be there
ALIGNED = (0.02, 0.05)  # Largest error of feet side by side that need no closing step [m, rad]


def level_pose(x: float, y: float, z: float, yaw: float) -> SolePose:
    """Return a level sole in odom [m, rad]."""
    return SolePose(np.array((x, y, z)), rotation.yaw_matrix(yaw))


def beside(stance: SolePose, foot: int, width: float) -> SolePose:
    """Return a level sole of ``foot``, parallel to the other's at a lateral distance ``width`` [m]."""
    yaw = rotation.yaw_matrix(rotation.yaw(stance.rotation))
    return SolePose(stance.position + yaw @ np.array((0.0, width if foot == LEFT else -width, 0.0)), yaw)


def side_by_side(sole: SolePose, place: SolePose) -> bool:
    """Return whether a sole is so near its place next to the other that it needs no closing step."""
    way, turn = place.position - sole.position, place.rotation @ sole.rotation.T
    return hypot(float(way[0]), float(way[1])) < ALIGNED[0] and abs(rotation.yaw(turn)) < ALIGNED[1]


class StepQueue:
    """``StepSource`` filled with a footstep plan: steps to come, the step under way, and the result.

    A step can be changed until it starts: last performed ≤ executing < first changeable, never decreasing in a plan.
    """

    def __init__(self) -> None:
        self.steps: list[Step] = []  # queued, the next first
        self.executing: Step | None = None  # under way, from the transfer of weight until its foot is down
        self.last: Step | None = None  # last step whose foot came down, or None
        self.state = "idle"  # idle, executing, finished or failed, as in ``StepStatus``
        self.reason = ""  # why a plan ends before its last step; else an empty string
        self.changes = 0  # number of changes of any of these
        self._walking = False  # the gait runs, with this plan or the last one
        self._just_finished = False

    @property
    def running(self) -> bool:
        """True if a plan runs, up to the rest after its last step."""
        return self.state == "executing"

    @property
    def stopping(self) -> bool:
        """True if the running plan has been stopped."""
        return self.running and bool(self.reason)

    @property
    def last_performed(self) -> int:
        """Index of the last completed step; -1: none."""
        return self.last.index if self.last else -1

    @property
    def first_changeable(self) -> int:
        """First index that an update may change, at most one after the last step; -1: none."""
        if not self.running or self.stopping:
            return -1
        if self.steps:
            return self.steps[0].index
        return (self.executing.index if self.executing else self.last_performed) + 1

    def status(self, time: int) -> StepStatus:
        """Return the status at robot time ``time`` [ns]."""
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
        """Return whether a plan has been finished since the last call."""
        finished, self._just_finished = self._just_finished, False
        return finished

    def begin(self, steps: Sequence[Step]) -> None:
        """Start a plan while none runs."""
        self.steps = list(steps)
        self.last, self.state, self.reason = None, "executing", ""
        self.changes += 1

    def update(self, steps: Sequence[Step]) -> None:
        """Replace the steps from the first one's index, which must be changeable."""
        first = steps[0].index
        self.steps = [step for step in self.steps if step.index < first] + list(steps)
        self.changes += 1

    def stop(self, reason: str, closing: Step | None = None) -> None:
        """End the plan after the step under way and an optional closing step."""
        if not self.steps or self.stopping:
            return
        self.steps = [closing] if closing else []
        self.reason = reason
        self.changes += 1
        if not self._walking:
            self._finish()

    def fail(self, reason: str) -> None:
        """End the plan at once."""
        self._walking = False
        if self.running:
            self.steps, self.executing = [], None
            self.state, self.reason = "failed", reason
            self.changes += 1

    def _finish(self) -> None:
        self.state, self._just_finished = "finished", True
        self.changes += 1

    def upcoming(self, soles: Sequence[SolePose]) -> Sequence[Step]:
        """Return the queued steps."""
        return self.steps

    def began(self, step: Step) -> None:
        """Remove the first step from the queue."""
        self.executing, self._walking = step, True
        self.steps = self.steps[1:]
        self.changes += 1

    def ended(self, step: Step) -> None:
        """Record the completed step."""
        self.executing, self.last = None, step
        self.changes += 1

    def rested(self) -> None:
        """Finish the plan, unless steps were added."""
        self._walking = False
        if self.running and not self.steps:
            self._finish()


class RecoverySteps:
    """``StepSource`` of fast steps on the spot, until the DCM is between feet side by side, at nominal width."""

    def __init__(self, robot: RobotDescription) -> None:
        self._walking, self._table = robot.tables.walking, robot.read(Tuning).disturbance
        self._foot = LEFT
        self._leads, self._more = True, MOST_MORE
        self.dcm = np.zeros(3)  # (3,) measured, for nominal arms; updated by the controller [m]
        foot = robot.tables.feet.left
        self._centre = np.array((0.5 * (foot.heel + foot.toe), 0.0, 0.0))  # of a sole [m]

    def lead(self, foot: int) -> None:
        """Make the next step one of ``foot``, at any position."""
        self._foot, self._leads, self._more = foot, True, MOST_MORE

    def upcoming(self, soles: Sequence[SolePose]) -> Sequence[Step]:
        """Return the next steps; none if the feet are side by side and the DCM is between them."""
        table, walking = self._table, self._walking
        foot, stance = self._foot, soles[1 - self._foot]
        if not self._leads and side_by_side(soles[foot], beside(stance, foot, walking.step_width)):
            centres = [sole.position + sole.rotation @ self._centre for sole in soles]
            x, y, _ = (self.dcm - 0.5 * (centres[0] + centres[1])).tolist()
            if not self._more or hypot(x, y) < table.recovered:
                return ()
            self._more -= 1
        steps = []
        for _ in range(AHEAD):
            sole = beside(stance, foot, walking.step_width)
            steps.append(
                Step(
                    index=-1,
                    foot=foot,
                    sole=sole,
                    swing_height=table.recovery_swing_height,
                    swing_duration=table.recovery_swing_duration,
                    transfer_duration=table.recovery_transfer_duration,
                    adjustable=inf,
                )
            )
            foot, stance = 1 - foot, sole
        return steps

    def began(self, step: Step) -> None:
        """Select the other foot."""
        self._foot, self._leads = 1 - step.foot, False

    def ended(self, step: Step) -> None:
        """Ignore the event."""

    def rested(self) -> None:
        """Ignore the event."""
