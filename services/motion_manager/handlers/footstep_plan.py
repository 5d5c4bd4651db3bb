"""``motion_manager/footstep_plan``: footstep plans, accepted or rejected completely, in the behaviors that step.

The rules are those of vigir_step_control. The first plan starts with step 0; a plan during another one starts with a
step that can still be changed, or with the one after the last. A plan without steps ends after the present step, feet
together. If the robot has already started the first step of an update, unchanged, the rest of the update is accepted.
"""

from __future__ import annotations

from dataclasses import replace
from math import hypot
from typing import TYPE_CHECKING

import numpy as np

from valor.common import rotation
from valor.common.behaviors import Locomotion
from valor.common.errors import RefusalError
from valor.common.messages import Footstep, FootstepPlanReply, FootstepPlanRequest
from valor.common.topics import FOOTSTEP_PLAN
from valor.control.steps import SolePose, Step
from valor.control.tuning_tables import Tuning
from valor.motion_manager.handlers.handler import RequestHandler, pose
from valor.robot.footsteps import FEET, LEFT, RIGHT, UNIT, StepRule

if TYPE_CHECKING:
    from valor.motion_manager.components import Components

TOGETHER = (0.02, 0.05)  # largest error of feet that are together [m, rad]


def _rejection(reason: str) -> RefusalError:
    return RefusalError("plan", reason)


class FootstepPlanHandler(RequestHandler[FootstepPlanRequest, FootstepPlanReply]):
    """Checks plans and forwards them to the step queue."""

    topic = FOOTSTEP_PLAN

    def __init__(self, components: Components) -> None:
        limits, self._walking = components.robot.tables.footsteps, components.robot.tables.walking
        self._rule = None if limits is None else StepRule(limits, components.robot.tables.feet)
        self._adjustable = components.robot.read(Tuning).disturbance.plan_reach
        super().__init__(components)
        self._fsm, self._queue = components.fsm, components.step_queue

    def handle(self, request: FootstepPlanRequest, origin: str) -> FootstepPlanReply:
        try:
            self._execute(request.steps, origin)
        except RefusalError as rejection:
            self.components.rejections.add(FOOTSTEP_PLAN.name, origin, rejection.kind, str(rejection))
            return FootstepPlanReply(accepted=False, behavior=self._fsm.behavior, reason=str(rejection))
        return FootstepPlanReply(accepted=True, behavior=self._fsm.behavior, reason="")

    def _execute(self, requested: list[Footstep], origin: str) -> None:
        if self._fsm.locomotion is not Locomotion.STEP:
            raise _rejection(
                "footstep plans are executed in behaviors step and step_manipulate; "
                f"the behavior is {self._fsm.behavior}; request one of them first"
            )
        if not requested:
            self._queue.stop(f"stopped by {origin}", self._closing())
            return
        rule = self._rule
        if rule is None:
            raise _rejection("this robot executes no footstep plans: its robot.yaml has no table footsteps")
        if len(requested) > rule.limits.max_steps:
            raise _rejection(f"{len(requested)} steps; expected at most {rule.limits.max_steps}")
        if self._queue.stopping:
            raise _rejection(f"the plan that runs is ending ({self._queue.reason}); send another once the robot stands")
        if self.components.whole_body.recovering:
            raise _rejection("the robot is stepping to keep its balance; send the plan once it stands")
        steps = self._to_come([self._step(step, rule) for step in requested])
        before = self._before(steps[0])
        other = before.sole if before is not None else self.components.soles()[1 - steps[0].foot]
        for step in steps:
            if before is not None:
                if step.index != before.index + 1:
                    raise _rejection(f"step {step.index} follows step {before.index}; expected step {before.index + 1}")
                if step.foot == before.foot:
                    raise _rejection(f"step {step.index} is of the {FEET[step.foot]} foot, as is the one before it")
            if reason := rule.beside(step, other):
                raise _rejection(reason)
            before, other = step, step.sole
        if self._queue.running:
            self._queue.update(steps)
        else:
            self._queue.begin(steps)

    def _to_come(self, steps: list[Step]) -> list[Step]:
        """The plan without its first step if the robot has already started it, unchanged."""
        first, executing = steps[0], self._queue.executing
        if executing is None or len(steps) == 1 or (first.index, first.foot) != (executing.index, executing.foot):
            return steps
        same = np.array_equal(first.sole.position, executing.sole.position)
        return steps[1:] if same and np.array_equal(first.sole.rotation, executing.sole.rotation) else steps

    def _before(self, first: Step) -> Step | None:
        """The step before the first one of a plan, or None; raises ``RefusalError`` if it cannot start there now."""
        queue = self._queue
        if not queue.running:
            if first.index != 0:
                raise _rejection(f"a plan starts with step 0; this one with step {first.index}")
            return None
        executing = queue.executing or queue.last
        known = [executing, *queue.steps] if executing else list(queue.steps)
        changeable = queue.first_changeable
        if executing is None and first.index == changeable:
            return None  # replaces a plan that has not started
        for before in known:
            if first.index == before.index + 1 >= changeable:
                return before
        raise _rejection(
            f"step {first.index} cannot be changed now; a plan may change from step {changeable}, "
            f"at the latest from step {known[-1].index + 1}"
        )

    def _closing(self) -> Step | None:
        """The step next to the present one; None without one, or if the feet will be together anyway."""
        last = self._queue.executing
        if last is None or self._rule is None:
            return None
        foot, walking = 1 - last.foot, self._walking
        offset = walking.step_width if foot == LEFT else -walking.step_width
        place = last.sole.position + last.sole.rotation @ np.array((0.0, offset, 0.0))
        step = Step(
            last.index + 1,
            foot,
            SolePose(place, last.sole.rotation),
            walking.plan_swing_height,
            walking.swing_duration,
            walking.transfer_duration,
        )
        stands = self.components.soles()[foot]
        way = place - stands.position
        turn = rotation.yaw(last.sole.rotation @ stands.rotation.T)
        if hypot(float(way[0]), float(way[1])) < TOGETHER[0] and abs(turn) < TOGETHER[1]:
            return None
        return None if self._rule.beside(step, last.sole) else step

    def _step(self, requested: Footstep, rule: StepRule) -> Step:
        """One checked step, with the robot's defaults for open values."""
        name, walking = f"step {requested.step_index}", self._walking
        if requested.foot not in (LEFT, RIGHT):
            raise _rejection(f"{name}: foot {requested.foot}; expected 0 (left) or 1 (right)")
        try:
            sole = SolePose(*pose(requested.position_in_odom, requested.orientation_in_odom, UNIT))
        except RefusalError as rejection:
            raise _rejection(f"{name}: {rejection}") from None
        step = Step(
            requested.step_index,
            requested.foot,
            sole,
            requested.swing_height,
            requested.swing_duration,
            requested.transfer_duration,
            self._adjustable,
        )
        if reason := rule.alone(step):
            raise _rejection(reason)
        return replace(
            step,
            swing_height=step.swing_height or walking.plan_swing_height,
            swing_duration=step.swing_duration or walking.swing_duration,
            transfer_duration=step.transfer_duration or walking.transfer_duration,
        )
