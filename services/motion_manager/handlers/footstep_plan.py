"""``motion_manager/footstep_plan``: footstep plans, admitted where the Locomotion FSM steps."""

from __future__ import annotations

from motion_manager.behavior_fsm import BehaviorFsm
from motion_manager.behaviors import UNAVAILABLE, Locomotion
from motion_manager.rejections import Rejections
from valor_common.messages import FootstepPlanReply, FootstepPlanRequest, StepStatus
from valor_common.topics import FOOTSTEP_PLAN


class FootstepPlanHandler:
    """Answers plans, and says how the running one fares."""

    def __init__(self, fsm: BehaviorFsm, rejections: Rejections) -> None:
        self._fsm = fsm
        self._rejections = rejections

    def handle(self, request: FootstepPlanRequest, origin: str) -> FootstepPlanReply:
        """Answer a plan of the node ``origin``."""
        reason = (
            f"footstep plans are executed in behaviors step and step_manipulate; the behavior is {self._fsm.behavior}"
        )
        if missing := UNAVAILABLE.get(Locomotion.STEP):
            reason = f"{reason}, and {missing}"
        self._rejections.add(FOOTSTEP_PLAN.name, origin, "behavior", reason)
        return FootstepPlanReply(accepted=False, behavior=self._fsm.behavior, reason=reason)

    def status(self, time: int) -> StepStatus:
        """What is being stepped, at robot time ``time`` [ns]."""
        return StepStatus(
            time=time,
            state="idle",
            reason="",
            queue_size=0,
            last_performed_step_index=-1,
            executing_step_index=-1,
            first_changeable_step_index=-1,
        )
