"""``motion_manager/footstep_plan``: footstep plans, checked whole, admitted where the Locomotion FSM steps.

The rules are those of vigir_step_control: where none runs a plan starts with step 0, otherwise with a step that can
still be changed, or with the one behind the last; a plan without steps stops after the step that is being taken, feet
together. Of a plan that the robot has overtaken on its way, what is still to come is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import hypot
from typing import Self

import numpy as np

from valor.common import rotation
from valor.common.behaviors import Locomotion
from valor.common.errors import RefusalError
from valor.common.messages import Footstep, FootstepPlanReply, FootstepPlanRequest
from valor.common.topics import FOOTSTEP_PLAN
from valor.motion_manager.handlers.handler import RequestHandler, pose
from valor.motion_manager.handlers.rejections import Rejections
from valor.motion_manager.parts import Parts
from valor.motion_manager.states.behavior_fsm import BehaviorFsm
from valor.robot.description import RobotDescription
from valor.robot.footsteps import FEET, LEFT, RIGHT, UNIT, StepRule
from valor.whole_body.tuning_tables import Tuning
from valor.whole_body.walking.footsteps import Step
from valor.whole_body.walking.step_queue import StepQueue
from valor.whole_body.walking.swing import SolePose

TOGETHER = (0.02, 0.05)  # feet so well side by side are together [m, rad]


class PlanError(RefusalError):
    """A plan that is not taken, and why."""

    def __init__(self, reason: str) -> None:
        super().__init__("plan", reason)


class FootstepPlanHandler(RequestHandler[FootstepPlanRequest, FootstepPlanReply]):
    """Answers plans."""

    topic = FOOTSTEP_PLAN

    def __init__(
        self,
        robot: RobotDescription,
        fsm: BehaviorFsm,
        queue: StepQueue,
        rejections: Rejections,
        soles: Callable[[], Sequence[SolePose]],
        *,
        recovering: Callable[[], bool],
    ) -> None:
        """Make the handler.

        Args:
            robot: its limits.
            fsm: the Behavior FSM.
            queue: where good plans go.
            rejections: where refusals are counted.
            soles: gives where the left and right sole are; asked in Step alone.
            recovering: whether the robot takes steps of its own to keep its balance.
        """
        limits, self._walking = robot.tables.footsteps, robot.tables.walking
        self._rule = None if limits is None else StepRule(limits, robot.tables.feet)
        self._adjustable = robot.read(Tuning).disturbance.plan_reach
        self._fsm = fsm
        self._queue = queue
        self._rejections = rejections
        self._soles = soles
        self._recovering = recovering

    @classmethod
    def of(cls, parts: Parts) -> Self:
        """The one of a Motion Manager."""
        return cls(
            parts.robot,
            parts.fsm,
            parts.step_queue,
            parts.rejections,
            parts.soles,
            recovering=lambda: parts.controller.recovering,
        )

    def handle(self, request: FootstepPlanRequest, origin: str) -> FootstepPlanReply:
        """Answer a plan of the node ``origin``: taken whole, or refused and nothing has changed."""
        try:
            self._take(request.steps, origin)
        except PlanError as refusal:
            self._rejections.add(FOOTSTEP_PLAN.name, origin, refusal.kind, str(refusal))
            return FootstepPlanReply(accepted=False, behavior=self._fsm.behavior, reason=str(refusal))
        return FootstepPlanReply(accepted=True, behavior=self._fsm.behavior, reason="")

    def _take(self, asked: list[Footstep], origin: str) -> None:
        if self._fsm.locomotion is not Locomotion.STEP:
            raise PlanError(
                "footstep plans are executed in behaviors step and step_manipulate; "
                f"the behavior is {self._fsm.behavior}; ask for one of them first"
            )
        if not asked:
            self._queue.stop(f"stopped by {origin}", self._closing())
            return
        rule = self._rule
        if rule is None:
            raise PlanError("the robot takes no footstep plans: its robot.yaml has no table footsteps")
        if len(asked) > rule.limits.max_steps:
            raise PlanError(f"{len(asked)} steps; expected at most {rule.limits.max_steps}")
        if self._queue.stopping:
            raise PlanError(f"the plan that runs is ending ({self._queue.reason}); send another once the robot stands")
        if self._recovering():
            raise PlanError("the robot is stepping to keep its balance; send the plan once it stands")
        steps = self._to_come([self._step(step, rule) for step in asked])
        before = self._before(steps[0])
        other = before.sole if before is not None else self._soles()[1 - steps[0].foot]
        for step in steps:
            if before is not None:
                if step.index != before.index + 1:
                    raise PlanError(f"step {step.index} follows step {before.index}; expected step {before.index + 1}")
                if step.foot == before.foot:
                    raise PlanError(f"step {step.index} is of the {FEET[step.foot]} foot, as is the one before it")
            if reason := rule.beside(step, other):
                raise PlanError(reason)
            before, other = step, step.sole
        if self._queue.running:
            self._queue.update(steps)
        else:
            self._queue.begin(steps)

    def _to_come(self, steps: list[Step]) -> list[Step]:
        """A plan without the step that is being taken, where it leaves that in place: it has begun meanwhile."""
        first, taken = steps[0], self._queue.executing
        if taken is None or len(steps) == 1 or (first.index, first.foot) != (taken.index, taken.foot):
            return steps
        same = np.array_equal(first.sole.position, taken.sole.position)
        return steps[1:] if same and np.array_equal(first.sole.rotation, taken.sole.rotation) else steps

    def _before(self, first: Step) -> Step | None:
        """The step that a plan's first one follows, or None.

        Raises:
            PlanError: the plan cannot begin with this step now.
        """
        queue = self._queue
        if not queue.running:
            if first.index != 0:
                raise PlanError(f"a plan begins with step 0; this one with step {first.index}")
            return None
        taken = queue.executing or queue.last
        known = [taken, *queue.steps] if taken else list(queue.steps)
        changeable = queue.first_changeable
        if taken is None and first.index == changeable:
            return None  # all of a plan that has not begun
        for before in known:
            if first.index == before.index + 1 >= changeable:
                return before
        raise PlanError(
            f"step {first.index} cannot be changed now; a plan may go on otherwise from step {changeable}, "
            f"at the latest from step {known[-1].index + 1}"
        )

    def _closing(self) -> Step | None:
        """The step beside the one that is being taken; None: none is, or the feet will be side by side anyway."""
        last = self._queue.executing
        if last is None or self._rule is None:
            return None
        foot, walking = 1 - last.foot, self._walking
        aside = walking.step_width if foot == LEFT else -walking.step_width
        place = last.sole.position + last.sole.rotation @ np.array((0.0, aside, 0.0))
        step = Step(
            last.index + 1,
            foot,
            SolePose(place, last.sole.rotation),
            walking.plan_swing_height,
            walking.swing_duration,
            walking.transfer_duration,
        )
        stands = self._soles()[foot]
        way = place - stands.position
        turn = rotation.yaw(last.sole.rotation @ stands.rotation.T)
        if hypot(float(way[0]), float(way[1])) < TOGETHER[0] and abs(turn) < TOGETHER[1]:
            return None
        return None if self._rule.beside(step, last.sole) else step

    def _step(self, asked: Footstep, rule: StepRule) -> Step:
        """One step, checked by itself, with the robot's own values where it leaves them open."""
        name, walking = f"step {asked.step_index}", self._walking
        if asked.foot not in (LEFT, RIGHT):
            raise PlanError(f"{name}: foot {asked.foot}; expected 0 (left) or 1 (right)")
        try:
            sole = SolePose(*pose(asked.position_in_odom, asked.orientation_in_odom, UNIT))
        except RefusalError as refusal:
            raise PlanError(f"{name}: {refusal}") from None
        step = Step(
            asked.step_index,
            asked.foot,
            sole,
            asked.swing_height,
            asked.swing_duration,
            asked.transfer_duration,
            self._adjustable,
        )
        if reason := rule.alone(step):
            raise PlanError(reason)
        return replace(
            step,
            swing_height=step.swing_height or walking.plan_swing_height,
            swing_duration=step.swing_duration or walking.swing_duration,
            transfer_duration=step.transfer_duration or walking.transfer_duration,
        )
