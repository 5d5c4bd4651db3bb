"""Loop of the operator's end of the link."""

import logging
import math
import time
from collections.abc import Callable, Mapping
from functools import partial
from operator import itemgetter
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from msgspec import structs
from rclpy.qos import DurabilityPolicy, QoSProfile
from valor_msgs.msg import ControllerStatus, Rejection

from valor.common.errors import ConfigurationError
from valor.common.instance import Link
from valor.common.linking import ports_to_robot
from valor.link.classes import MessageClass
from valor.link.endpoint import Arrived, Event, MessagesExpired, SessionStarted
from valor.link.endpoints import OperatorEndpoint
from valor.link.errors import SealError
from valor.link.fields import Layout
from valor.link.udp_transport import UdpTransport
from valor.link_operator.goals import CommandHistory, Goals
from valor.link_operator.republisher import LATCHED, PicturePublisher, Progress, Republisher
from valor.ros.controllers import STATUS
from valor.ros.lateness import Info, reject_late
from valor.ros.link_loop import create_session, serve
from valor.ros.link_messages import (
    COMMANDS,
    Command,
    LinkMessageType,
    MessageCodec,
    class_of,
    pack_message,
    unpack_message,
)
from valor.ros.node import ProcessNode, RosSide
from valor.ros.transforms import ODOM
from valor.service import Context

STATUS_PERIOD = 0.2  # [s]
OLD = 1.0  # age of the state from which on the status is a warning [s]
LONGEST_AHEAD = 0.25  # robot time that is published without another state [s]
STOP_WINDOW = 0.5  # after a stop, in which DDS may still deliver what was sent before it on another topic [s]
REJECTIONS = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
WITH_STOP = "received together with a stop; send it again if it is still wanted"
_RESTARTED = "the link was restarted; result unknown"
_log = logging.getLogger("link_operator")


class LinkOperator:
    """Serves the operator's ROS domain."""

    def __init__(self, context: Context) -> None:
        """Join the operator's domain. Raises ConfigurationError: no domain, or the robot's."""
        settings = context.settings
        if settings.link.domain is None or (not settings.hosts and settings.link.domain == settings.ros_domain_id):
            raise ConfigurationError(f"link: domain: got {settings.link.domain}; expected another than the robot's")
        self._context = context
        self._link = settings.link
        session = create_session(context.instance, context.name, context.robot)
        operator_settings = structs.replace(settings, ros_domain_id=settings.link.domain)
        environment = context.instance.environment()
        make_node = partial(ProcessNode, sets_time=True, others=bool(settings.peers))
        self._side = RosSide(context.name, operator_settings, environment, context.arguments, node=make_node)
        node, self._layout = self._side.node, Layout(context.robot)
        self._end = OperatorEndpoint(session, self._layout, time.monotonic(), fast=True, rate=settings.link.rate)
        others = [(self._link.robot, port) for port in ports_to_robot(settings)]
        self._transport = UdpTransport(self._end, other=others)
        self._picture = PicturePublisher(node, self._end)
        self._codec = MessageCodec(context.robot)
        self._republisher = Republisher(node, context.robot, settings)
        self._history = CommandHistory()
        self._waiting: list[tuple[int, Callable[[], None]]] = []  # commands with their times of reception [ns]
        self._stopped_at = -math.inf  # monotonic time of the latest stop [s]
        self._goals = Goals(node, self._end, self._codec, self._history, self._send_waiting)
        self._progress = Progress(node, f"{settings.frame_prefix}{ODOM}", self._goals.feedback)
        self._rejections = node.create_publisher(Rejection, "flor/controller/rejection", REJECTIONS)
        self._controllers = node.create_publisher(ControllerStatus, STATUS, LATCHED)
        self._status = node.create_publisher(DiagnosticStatus, "link/status", LATCHED)
        for index, command in enumerate(COMMANDS):
            receive = reject_late(command.name, partial(self._receive, index, command), others=node.others)
            node.create_subscription(command.type, command.name, receive, 10)
        self._published_clock, self._shown, self._status_at = -1, (0, 0.0), 0.0
        self._time = 0
        self._side.life.configure()

    def run(self) -> None:
        """Serve until the process is stopped."""
        serve(self._context, self._side, self._end, self._transport, self._turn)

    def _turn(self, now: float) -> None:
        self._send_waiting()
        for event in self._end.events():
            self._process(event)
        self._publish_state(now)
        self._picture.turn(now)
        if now - self._status_at >= STATUS_PERIOD:
            self._status_at = now
            self._status.publish(status(self._end, self._layout, self._link, now, self._history.lines(now)))

    def _publish_state(self, now: float) -> None:
        state = self._end.state
        if state is not None and state.clock != self._published_clock:
            self._published_clock, self._shown = state.clock, (state.stamp, now)
            self._time = max(self._time, state.stamp * 10**6)
            self._side.node.set_time(self._time)
            self._republisher.tick(self._time)
            self._republisher.publish(state)
        elif state is not None:
            ahead = min(now - self._shown[1], LONGEST_AHEAD)
            self._time = max(self._time, self._shown[0] * 10**6 + round(1e9 * ahead))
            self._republisher.tick(self._time)

    def _receive(self, index: int, command: Command, message: Any, info: Info) -> None:
        """Send a stop at once; other commands wait until all that has been received with them is known."""
        kind = class_of(command, message)
        content = pack_message(LinkMessageType.TOPIC, index, self._codec.pack(message))
        if kind is MessageClass.STOP:
            self._send(command.name, kind, content)
            self._stopped_at = time.monotonic()
        else:
            self._waiting.append(
                (info.get("received_timestamp") or 0, partial(self._send, command.name, kind, content))
            )

    def _send_waiting(self) -> str:
        """Send waiting commands in the order of reception; returns the reason to reject commands, empty if none."""
        waiting, self._waiting = self._waiting, []
        for _, send in sorted(waiting, key=itemgetter(0)):
            send()
        return self._stop_beside(time.monotonic())

    def _stop_beside(self, now: float) -> str:
        """Reason to reject a command that is taken at ``now``, monotonic [s]; empty if no stop is so near."""
        return WITH_STOP if now - self._stopped_at < STOP_WINDOW else ""

    def _send(self, topic: str, kind: MessageClass, content: bytes) -> None:
        now = time.monotonic()
        try:
            if kind is not MessageClass.STOP and (reason := self._stop_beside(now)):
                raise SealError(reason)
            if kind is MessageClass.STREAM:
                self._end.stream(kind, content, now)
            else:
                self._history.sent(self._end.send(kind, content, now), topic)
        except SealError as error:
            self._history.unsent(topic, str(error))
            self._publish_rejection(topic, f"not sent: {error}")

    def _reject(self, number: int, reason: str) -> None:
        name = self._history.name(number)
        self._goals.reject(number, reason)
        self._publish_rejection(name or "link", f"command {number}: {reason}")

    def _publish_rejection(self, topic: str, reason: str) -> None:
        _log.warning("%s %s", topic, reason)
        self._rejections.publish(Rejection(topic=topic, origin="link_operator", reason=reason))

    def _process(self, event: Event) -> None:
        if isinstance(event, SessionStarted):
            _log.info("session %d with the robot's end", self._end.session.number)
            self._goals.end_session(_RESTARTED)
            self._history.end_session(_RESTARTED)
        elif isinstance(event, MessagesExpired):
            for number in event.ids:
                self._goals.expired(number)
                self._reject(number, "not acknowledged before its deadline")
        elif isinstance(event, Arrived):
            self._take(event)

    def _take(self, arrived: Arrived) -> None:
        try:
            type_, number, content = unpack_message(arrived.content)
            if type_ is LinkMessageType.ACCEPTED:
                self._goals.accepted(number)
            elif type_ is LinkMessageType.REFUSED:
                self._reject(number, content.decode(errors="replace"))
            elif type_ is LinkMessageType.RESULT:
                self._goals.end(number, content)
            elif type_ is LinkMessageType.REJECTION:
                self._rejections.publish(self._codec.unpack(content, Rejection))
            elif type_ is LinkMessageType.STEPS:
                self._progress.steps(content)
            elif type_ is LinkMessageType.PROGRESS:
                self._progress.plan(number, content)
            elif type_ is LinkMessageType.HAND:
                self._progress.hand(number, content)
            elif type_ is LinkMessageType.CONTROLLERS:
                self._controllers.publish(self._codec.unpack(content, ControllerStatus))
        except SealError as error:
            _log.warning("%s of the robot's end: %s", arrived.kind.name, error)

    def close(self) -> None:
        """Leave ROS; the robot continues."""
        self._transport.close()
        self._goals.close()
        self._side.close()


def status(
    end: OperatorEndpoint, layout: Layout, link: Link, now: float, commands: Mapping[str, str]
) -> DiagnosticStatus:
    """``/link/status`` at the monotonic time ``now`` [s]; ages are upper bounds [s].

    ``link`` has the reaction to a lost operator, ``commands`` is of ``CommandHistory.lines``.
    """
    state = end.state
    message = DiagnosticStatus(name="link")
    if state is None or not end.session.established:
        message.level = DiagnosticStatus.ERROR
        message.message = end.session.mismatch or "no datagram of the robot's end has been received"
        message.values = [KeyValue(key=key, value=value) for key, value in commands.items()]
        return message
    age, silence, picture_age = end.age(now), end.silence(now), end.picture_age(now)
    message.level = DiagnosticStatus.WARN if age > OLD else DiagnosticStatus.OK
    message.message = f"no datagram of the robot's end for {silence:.1f} s" if silence > OLD else "connected"
    clamped = [name for name, part in layout.slices.items() if state.clamped[part].any()]
    values = {
        "state_age": f"{age:.3f}", "stamp": f"{1e-3 * state.stamp:.3f}",
        "mode": state.mode, "mode_age": f"{state.mode_age + age:.3f}",
        "behavior": state.behavior, "behavior_age": f"{state.behavior_age + age:.3f}",
        "velocity_age": f"{state.velocity_age + age:.3f}",
        **({"picture_age": f"{picture_age:.3f}"} if picture_age < math.inf else {}),
        "step": str(state.step), "clamped_fields": " ".join(clamped), "fast_channel": str(end.fast(now)).lower(),
        **commands, "states": str(end.states),
        "when_lost": link.when_lost, "lost_after": f"{link.lost_after:g}",
        **{f"sent.{name}": f"{rate:.0f} B/s" for name, rate in sorted(end.meter.rates(now).items())},
        **{f"received.{name}": f"{rate:.0f} B/s" for name, rate in sorted(end.received_meter.rates(now).items())},
    }  # fmt: skip
    message.values = [KeyValue(key=key, value=value) for key, value in values.items()]
    return message
