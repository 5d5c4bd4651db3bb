"""A Motion Manager that does as it is commanded, in the real one's place on Bifrost."""

import threading
from collections.abc import Callable
from typing import Any

import bifrost
from harness.motion_states import motion_state
from harness.waiting import wait_until
from tests.integration.plan_client import LIMIT, Goal, PlanClient, plan
from valor.common.messages import FootstepPlanReply, FootstepPlanRequest, MotionState, StepStatus
from valor.common.topics import FOOTSTEP_PLAN, MOTION_STATE, STEP_STATUS


class ScriptedMotionManager:
    """Answers plans as it is commanded and reports what it is commanded, 50 times a second."""

    def __init__(self, node: bifrost.Node) -> None:
        self._node = node
        self.requests: list[FootstepPlanRequest] = []
        self.accepts: Callable[[FootstepPlanRequest], tuple[bool, str]] = lambda request: (True, "")
        self.behavior, self.reason = "stand", ""
        self.step_status: StepStatus | None = None
        self.silent = False
        self._server = FOOTSTEP_PLAN.server(node, self._answer)
        # Latched, for such a publisher alone knows who receives it.
        self._state = node.publisher(MOTION_STATE.name, MotionState, latched=True)
        self._status = node.publisher(STEP_STATUS.name, StepStatus, latched=True)
        self._publishing = threading.Lock()  # a publisher is of one thread at a time
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _answer(self, request: FootstepPlanRequest, origin: str) -> FootstepPlanReply:
        assert origin == "footstep_converter"
        self.requests.append(request)
        accepted, reason = self.accepts(request)
        return FootstepPlanReply(accepted=accepted, behavior=self.behavior, reason=reason)

    def report(self, state: str, performed: int = -1, executing: int = -1, **more: Any) -> None:
        self.step_status = StepStatus(
            time=more.get("time", 5_000_000_000), state=state, reason=more.get("reason", ""),
            queue_size=more.get("queue", 0), last_performed_step_index=performed, executing_step_index=executing,
            first_changeable_step_index=more.get("changeable", -1),
        )  # fmt: skip

    def publish(self) -> None:
        assert self.step_status is not None
        with self._publishing:
            self._status.publish(self.step_status)

    def wait_until_received(self) -> None:
        """Until the converter receives what is said of the plan."""
        wait_until(lambda: self._status.subscribers, LIMIT, "a subscriber to the step status")

    def wait_until_seen(self) -> None:
        """Until the converter receives what is said of the robot, which it does while a plan runs."""
        wait_until(lambda: self._state.subscribers, LIMIT, "a subscriber to the motion state")

    def _run(self) -> None:
        while not self._stop.wait(0.02):
            if self.silent:
                continue
            self._server.serve()
            status = self.step_status
            if status is not None:
                status.time += 1_000_000
                with self._publishing:
                    self._status.publish(status)
            time = status.time + 1 if status else 0
            self._state.publish(motion_state(time=time, behavior=self.behavior, reason=self.reason))

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._node.close()


def begin(motion: ScriptedMotionManager, client: PlanClient) -> Goal:
    motion.requests.clear()
    goal = client.send(plan())
    wait_until(lambda: motion.requests, LIMIT, "the plan at the Motion Manager")
    motion.behavior = "step"
    motion.report("executing", performed=0, executing=1, queue=3, changeable=2)
    wait_until(lambda: any(f.currently_executing_step_index == 1 for f in goal.feedback), LIMIT, "the plan under way")
    motion.wait_until_seen()
    return goal
