"""Clients that request plans over ROS (action ExecuteStepPlan, topic StepPlan), and frames of plans.

Both kinds of clients receive feedback and the outcome; the feedback of every plan is also published on a topic.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Sequence

from builtin_interfaces.msg import Time
from rclpy.action import CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.timer import Timer
from tf2_msgs.msg import TFMessage
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_footstep_planning_msgs.msg import FootstepExecutionStatus, Step, StepPlan

from valor.common.input_checks import TopicFloods
from valor.common.poses import Pose
from valor.common.transforms import TransformBuffer
from valor.footstep_converter.execution import End, Execution, PlanOutcome, aborted
from valor.footstep_converter.plan import PlannedStep
from valor.ros.deferred_action_server import DeferredActionServer
from valor.ros.lateness import reject_late
from valor.ros.node import STEADY, ProcessNode

NAMESPACE = "robot_controllers/footstep_controller"
EXECUTE = f"{NAMESPACE}/execute_step_plan"  # the action, and the topic
FEEDBACK = f"{NAMESPACE}/execute_feedback"
RESULT_DELAY = 0.1  # from the last feedback to the result, after which a client ignores feedback [s]
FEEDBACK_QUEUE = 50  # latched feedback messages, 5 s: longer than a retransmission takes

FEEDBACK_MESSAGE = ExecuteStepPlan.Impl.FeedbackMessage
"""Feedback with its goal: of the action's types, the one that ``ros2 topic`` imports by name."""
_STATES = {End.SUCCEEDED: "succeed", End.ABORTED: "abort", End.CANCELED: "canceled"}
_C, _F = ExecuteStepPlan.Feedback, FootstepExecutionStatus


class PlanGoal:
    """Requested plan, and reports to its client."""

    def __init__(self, clients: Clients, plan: StepPlan, handle: ServerGoalHandle | None = None) -> None:
        """``handle``: of the action's goal; None: of the topic, whose clients receive no result."""
        self.plan = plan  # requested
        self.cancel_requested = False  # by the client
        self.ended = False  # the outcome was reported
        self._clients, self._handle = clients, handle
        self._plan: list[PlannedStep] = []  # whose messages are the steps
        self._steps: list[Step] = []

    def report_waiting(self, steps: Sequence[PlannedStep]) -> None:
        """Report that these steps are being sent: none has started, all can be changed."""
        feedback, first = self._feedback(None), steps[0].index
        feedback.queue_size = len(steps)
        feedback.first_queued_step_index, feedback.last_queued_step_index = first, steps[-1].index
        feedback.last_performed_step_index = feedback.currently_executing_step_index = first - 1
        feedback.first_changeable_step_index = first
        self._clients.publish(feedback, self._handle)

    def report_progress(self, execution: Execution | None) -> None:
        """Report the progress; None: unknown."""
        self._clients.publish(self._feedback(execution), self._handle)

    def end(self, outcome: PlanOutcome, execution: Execution | None = None) -> None:
        """Report the outcome, once. The last feedback has the text, for which the result has no field."""
        if self.ended:
            return
        self.ended = True
        feedback = self._feedback(execution)
        feedback.controller_state, feedback.stepping_status = _final_state(outcome), outcome.status
        feedback.status.error, feedback.status.error_msg = outcome.error, outcome.text
        self._clients.publish(feedback, self._handle)
        if self._handle is not None:
            self._clients.finish(self._handle, outcome)

    def _feedback(self, execution: Execution | None) -> ExecuteStepPlan.Feedback:
        """Progress of a plan; None: unknown, or no plan is followed."""
        feedback = ExecuteStepPlan.Feedback()
        feedback.header.frame_id = feedback.feedback.header.frame_id = self._clients.frame
        feedback.first_queued_step_index = feedback.last_queued_step_index = -1
        feedback.last_performed_step_index = feedback.currently_executing_step_index = -1
        feedback.first_changeable_step_index = -1
        time = self._clients.now() if execution is None else execution.progress.time
        feedback.header.stamp = feedback.feedback.header.stamp = Time(sec=time // 10**9, nanosec=time % 10**9)
        if execution is None:
            feedback.controller_state, feedback.stepping_status = int(_C.READY), int(_F.WAITING_FOR_ATLAS)
            return feedback
        progress = execution.progress
        feedback.controller_state, feedback.stepping_status = int(_C.ACTIVE), int(_F.EXECUTING_STEP_PLAN)
        feedback.queue_size = progress.queue_size
        if progress.queue_size > 0:
            feedback.first_queued_step_index = execution.last_index - progress.queue_size + 1
            feedback.last_queued_step_index = execution.last_index
        feedback.last_performed_step_index = progress.performed
        feedback.currently_executing_step_index = progress.executing
        feedback.first_changeable_step_index = progress.changeable
        if execution.plan is not self._plan:
            self._plan, self._steps = execution.plan, [_message(step, self._clients.frame) for step in execution.plan]
        feedback.feedback.steps = self._steps
        return feedback


class Clients:
    """Serves the action and the topic."""

    def __init__(
        self,
        node: ProcessNode,
        begin: Callable[[PlanGoal], None],
        stop: Callable[[PlanGoal], None],
        *,
        now: Callable[[], int],
        frame: str,
    ) -> None:
        """Open the interfaces; ``begin`` is called with each new goal, ``stop`` with each that its client cancels.

        ``now``: returns robot time [ns]; ``frame``: tf frame odom.
        """
        self._node, self._begin, self._stop = node, begin, stop
        self.now, self.frame = now, frame
        self._goals: dict[bytes, PlanGoal] = {}
        latched = QoSProfile(depth=FEEDBACK_QUEUE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._feedback = node.create_publisher(FEEDBACK_MESSAGE, FEEDBACK, latched)
        self.floods = TopicFloods(lambda topic: (one.node_name for one in node.get_publishers_info_by_topic(topic)))
        topic = node.resolve_topic_name(EXECUTE)
        published = self.floods.counted(topic, lambda plan: begin(PlanGoal(self, plan)))
        node.create_subscription(StepPlan, EXECUTE, reject_late(topic, published, others=node.others), 10)
        late = self._late if node.others else None
        self._server = DeferredActionServer(
            node, ExecuteStepPlan, EXECUTE, lambda handle: begin(self._open(handle)), self._cancel, on_late=late
        )

    def publish(self, feedback: ExecuteStepPlan.Feedback, handle: ServerGoalHandle | None) -> None:
        """Publish feedback; plans of the topic have no goal id."""
        message = FEEDBACK_MESSAGE(feedback=feedback)
        if handle is not None:
            handle.publish_feedback(feedback)
            message.goal_id = handle.goal_id
        self._feedback.publish(message)

    def finish(self, handle: ServerGoalHandle, outcome: PlanOutcome) -> None:
        """Send the result after ``RESULT_DELAY``."""
        result = ExecuteStepPlan.Result(controller_state=_final_state(outcome))
        result.status.header.frame_id = self.frame
        result.status.status = outcome.status

        def send() -> None:
            self._node.destroy_timer(timer)
            del self._goals[bytes(handle.goal_id.uuid)]
            self._server.finish(handle, _STATES[outcome.end], result)

        timer: Timer = self._node.create_timer(RESULT_DELAY, send, clock=STEADY)

    def _open(self, handle: ServerGoalHandle) -> PlanGoal:
        goal = self._goals[bytes(handle.goal_id.uuid)] = PlanGoal(self, handle.request.step_plan, handle)
        return goal

    def _late(self, handle: ServerGoalHandle, reason: str) -> None:
        self._open(handle).end(aborted(_F.ERR_UNKNOWN, reason))

    def _cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        goal = self._goals.get(bytes(handle.goal_id.uuid))
        if goal is None or goal.ended:
            return CancelResponse.REJECT
        goal.cancel_requested = True
        self._stop(goal)
        return CancelResponse.ACCEPT

    @property
    def open_goals(self) -> list[PlanGoal]:
        """Goals whose clients wait for a result."""
        return list(self._goals.values())

    def close(self) -> None:
        self._server.destroy()


def _final_state(outcome: PlanOutcome) -> int:
    """State of the result: FINISHED or FAILED."""
    return int(_C.FINISHED if outcome.end is End.SUCCEEDED else _C.FAILED)


def _message(planned: PlannedStep, frame: str) -> Step:
    step = Step(step_index=planned.index, valid=True)
    step.header.frame_id = step.foot.header.frame_id = frame
    step.foot.foot_index = planned.foot
    p, q = step.foot.pose.position, step.foot.pose.orientation
    p.x, p.y, p.z = planned.sole.position
    q.w, q.x, q.y, q.z = planned.sole.orientation
    step.swing_height = planned.swing_height
    step.step_duration, step.sway_duration = planned.swing_duration, planned.transfer_duration
    return step


ODOM = "odom"

HISTORY = 10.0  # of transforms, as in tf2 [s]
MAX_UNREAD = 5000  # stored messages

_log = logging.getLogger("footstep_converter")


class Frames:
    """Received transforms, stored as bytes and deserialized when a plan outside odom arrives."""

    def __init__(self, node: Node, prefix: str) -> None:
        """``prefix``: of the robot's frames."""
        self._odom = prefix + ODOM
        self._buffer = TransformBuffer(HISTORY)
        self._unread: deque[tuple[float, bytes]] = deque(maxlen=MAX_UNREAD)
        latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_subscription(TFMessage, "/tf", self._store, 100, raw=True)
        node.create_subscription(TFMessage, "/tf_static", lambda message: self._add(message, static=True), latched)

    def in_odom(self, frame: str, stamp: int) -> Pose | None:
        """Pose of a frame in odom at a time [ns]; 0: latest. None: the frame is odom.

        Raises TooNewError: not yet received for that time; TransformError: unknown.
        """
        if frame.lstrip("/") == self._odom:
            return None
        while self._unread:
            _, data = self._unread.popleft()
            self._add(deserialize_message(data, TFMessage), static=False)
        return self._buffer.lookup(self._odom, frame, stamp)

    def _store(self, data: bytes) -> None:
        now = time.monotonic()
        self._unread.append((now, data))
        while now - self._unread[0][0] > HISTORY:
            self._unread.popleft()

    def _add(self, message: TFMessage, *, static: bool) -> None:
        for each in message.transforms:
            t, r, stamp = each.transform.translation, each.transform.rotation, each.header.stamp
            try:
                self._buffer.add(
                    each.header.frame_id,
                    each.child_frame_id,
                    stamp.sec * 10**9 + stamp.nanosec,
                    Pose((t.x, t.y, t.z), (r.w, r.x, r.y, r.z)),
                    static=static,
                )
            except ValueError as error:
                _log.warning("tf: %s", error)
