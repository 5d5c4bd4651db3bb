"""Connection to the Motion Manager over Bifrost."""

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

import bifrost
from valor.common.messages import Footstep, FootstepPlanReply, FootstepPlanRequest, MotionState, StepStatus
from valor.common.topics import FOOTSTEP_PLAN, MOTION_STATE, STEP_STATUS
from valor.footstep_converter.plan import PlannedStep

QUEUE = 64  # step statuses
ANSWER = 2.0  # timeout of a plan request [s]


def footstep(step: PlannedStep) -> Footstep:
    return Footstep(
        step_index=step.index,
        foot=step.foot,
        position_in_odom=np.array(step.sole.position),
        orientation_in_odom=np.array(step.sole.orientation),
        swing_height=step.swing_height,
        swing_duration=step.swing_duration,
        transfer_duration=step.transfer_duration,
    )


class MotionSystem:
    """Sends plans without blocking, in a separate thread, and receives their status in the caller's."""

    def __init__(self, node: bifrost.Node) -> None:
        self._node = node
        self._client = FOOTSTEP_PLAN.client(node)
        self._step_status = STEP_STATUS.subscriber(node, queue=QUEUE)
        self.subscribers = {STEP_STATUS: self._step_status}
        self.time = 0  # of the latest step status [ns]
        # Subscribed to only while a plan runs: 500 messages a second.
        self._motion_state: bifrost.Subscriber[MotionState] | None = None
        self._requests = ThreadPoolExecutor(max_workers=1, thread_name_prefix="requests")

    @property
    def drops(self) -> int:
        return self._step_status.drops

    def request(self, steps: Sequence[PlannedStep], answered: Callable[[], None]) -> Future[FootstepPlanReply]:
        """Send a plan, or a stop (no steps); ``answered`` is called from another thread when the future is done."""
        request = FootstepPlanRequest(steps=[footstep(step) for step in steps])
        future = self._requests.submit(self._client.call, request, ANSWER)
        future.add_done_callback(lambda _: answered())
        return future

    def watch(self, watched: bool) -> None:
        """Subscribe to the Motion Manager's behavior, or end the subscription."""
        if watched and self._motion_state is None:
            self._motion_state = MOTION_STATE.subscriber(self._node)
        elif not watched and self._motion_state is not None:
            self._motion_state.close()
            self._motion_state = None

    def behavior(self) -> MotionState | None:
        """Latest unread motion state, while subscribed."""
        received = self._motion_state.latest() if self._motion_state is not None else None
        return received.message if received is not None else None

    def step_statuses(self) -> list[StepStatus]:
        """Step statuses received since the last call."""
        statuses = [received.message for received in self._step_status.drain(QUEUE)]
        self.time = statuses[-1].time if statuses else self.time
        return statuses

    def close(self) -> None:
        """Wait for the request in progress; discard waiting ones."""
        self._requests.shutdown(wait=True, cancel_futures=True)
        self.watch(False)
