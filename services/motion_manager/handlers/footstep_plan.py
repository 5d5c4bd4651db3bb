"""``motion_manager/footstep_plan``: footstep plans, checked whole, admitted where the Locomotion FSM steps.

The rules are those of vigir_step_control: with an empty queue a plan starts with step 0, otherwise with a queued step
that can still be changed; a plan without steps stops after the step that is being taken.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isfinite

import numpy as np

from motion_manager.behavior_fsm import BehaviorFsm
from motion_manager.behaviors import Locomotion
from motion_manager.rejections import Rejections
from motion_manager.whole_body import rotation
from motion_manager.whole_body.walking.footsteps import FEET, Step, reach_refusal
from motion_manager.whole_body.walking.step_queue import StepQueue
from motion_manager.whole_body.walking.swing import SolePose
from valor_common.messages import Footstep, FootstepPlanReply, FootstepPlanRequest, StepStatus
from valor_common.robot import RobotDescription
from valor_common.topics import FOOTSTEP_PLAN

NORM = 1e-3  # most that a quaternion's norm may be off


class PlanError(Exception):
    """A plan that is not taken, and why."""


class FootstepPlanHandler:
    """Answers plans, and says how the running one fares."""

    def __init__(
        self,
        robot: RobotDescription,
        fsm: BehaviorFsm,
        queue: StepQueue,
        rejections: Rejections,
        soles: Callable[[], Sequence[SolePose]],
    ) -> None:
        """Make the handler.

        Args:
            robot: its limits.
            fsm: the Behavior FSM.
            queue: where good plans go.
            rejections: where refusals are counted.
            soles: gives where the left and right sole are; asked in Step alone.
        """
        self._limits, self._walking = robot.tables.footsteps, robot.tables.walking
        self._fsm = fsm
        self._queue = queue
        self._rejections = rejections
        self._soles = soles

    def handle(self, request: FootstepPlanRequest, origin: str) -> FootstepPlanReply:
        """Answer a plan of the node ``origin``: taken whole, or refused and nothing has changed."""
        try:
            self._take(request.steps, origin)
        except PlanError as refusal:
            self._rejections.add(FOOTSTEP_PLAN.name, origin, "plan", str(refusal))
            return FootstepPlanReply(accepted=False, behavior=self._fsm.behavior, reason=str(refusal))
        return FootstepPlanReply(accepted=True, behavior=self._fsm.behavior, reason="")

    @property
    def changes(self) -> int:
        """How often ``status`` changed since start."""
        return self._queue.changes

    def status(self, time: int) -> StepStatus:
        """What is being stepped, at robot time ``time`` [ns]."""
        queue = self._queue
        return StepStatus(
            time=time,
            state=queue.state,
            reason=queue.reason,
            queue_size=len(queue.steps),
            last_performed_step_index=queue.last_performed,
            executing_step_index=queue.executing.index if queue.executing else -1,
            first_changeable_step_index=queue.steps[0].index if queue.steps else -1,
        )

    def _take(self, asked: list[Footstep], origin: str) -> None:
        if self._fsm.locomotion is not Locomotion.STEP:
            raise PlanError(
                "footstep plans are executed in behaviors step and step_manipulate; "
                f"the behavior is {self._fsm.behavior}"
            )
        if not asked:
            self._queue.stop(f"stopped by {origin}")
            return
        if self._limits is None:
            raise PlanError("the robot takes no footstep plans: its robot.yaml has no table footsteps")
        if len(asked) > self._limits.max_steps:
            raise PlanError(f"{len(asked)} steps; expected at most {self._limits.max_steps}")
        steps = [self._step(step) for step in asked]
        before = self._before(steps[0])
        for step in steps:
            if before is not None:
                if step.index != before.index + 1:
                    raise PlanError(f"step {step.index} follows step {before.index}; expected step {before.index + 1}")
                if step.foot == before.foot:
                    raise PlanError(f"step {step.index} is of the {FEET[step.foot]} foot, as is the one before it")
            other = before.sole if before is not None else self._soles()[1 - step.foot]
            if reason := reach_refusal(step, other, self._limits):
                raise PlanError(reason)
            before = step
        if self._queue.steps:
            self._queue.update(steps)
        else:
            self._queue.begin(steps)

    def _before(self, first: Step) -> Step | None:
        """The step that a plan's first one follows, or None.

        Raises:
            PlanError: the plan cannot begin with this step now.
        """
        queued, executing = self._queue.steps, self._queue.executing
        if not queued and executing is None:
            if first.index != 0:
                raise PlanError(f"a plan begins with step 0; this one with step {first.index}")
            return None
        for before, step in zip([executing, *queued], queued, strict=False):
            if step.index == first.index:
                return before
        changeable = f"steps {queued[0].index} to {queued[-1].index}" if queued else "none"
        raise PlanError(f"step {first.index} cannot be changed now; changeable: {changeable}")

    def _step(self, asked: Footstep) -> Step:
        """One step, checked by itself, with the robot's own values where it leaves them open."""
        name, limits, walking = f"step {asked.step_index}", self._limits, self._walking
        assert limits is not None
        if asked.foot not in (0, 1):
            raise PlanError(f"{name}: foot {asked.foot}; expected 0 (left) or 1 (right)")
        place, orientation = asked.position_in_odom, asked.orientation_in_odom
        if place.shape != (3,) or orientation.shape != (4,):
            raise PlanError(f"{name}: position and orientation have {place.size} and {orientation.size} numbers")
        if not (np.isfinite(place).all() and np.isfinite(orientation).all()):
            raise PlanError(f"{name}: position or orientation is not finite")
        if abs(float(np.linalg.norm(orientation)) - 1.0) > NORM:
            raise PlanError(f"{name}: the orientation is no unit quaternion")
        height = asked.swing_height or walking.swing_height
        swing = asked.swing_duration or walking.swing_duration
        transfer = asked.transfer_duration or walking.transfer_duration
        for what, value, low, high in (
            ("swing_height", height, 0.0, limits.max_swing_height),
            ("swing_duration", swing, limits.min_swing_duration, limits.max_swing_duration),
            ("transfer_duration", transfer, limits.min_transfer_duration, limits.max_transfer_duration),
        ):
            if not isfinite(value) or not low <= value <= high:
                raise PlanError(f"{name}: {what} {value}; expected {low} to {high}")
        matrix = np.empty((3, 3))
        rotation.matrix(rotation.quaternion(orientation), matrix)
        return Step(asked.step_index, asked.foot, SolePose(place.copy(), matrix), height, swing, transfer)
