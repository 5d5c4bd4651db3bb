"""The loop: states in, to ROS; commands of the operator's domain out."""

from __future__ import annotations

import logging
import time
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from msgspec import structs
from rclpy.qos import DurabilityPolicy, QoSProfile
from valor_msgs.msg import Rejection

from valor.common.errors import ConfigurationError
from valor.common.linking import ports_to_robot
from valor.link.bulk.fetcher import Fetcher
from valor.link.carrier import Carrier
from valor.link.classes import Kind
from valor.link.end import Arrived, Began, Event, GivenUp
from valor.link.ends import OperatorEnd
from valor.link.errors import SealError
from valor.link.fields import Layout
from valor.link.joining import session
from valor.link_operator.beyond import Beyond
from valor.link_operator.fates import Fates
from valor.link_operator.goals import Goals
from valor.link_operator.progress import Progress
from valor.link_operator.republisher import LATCHED, Republisher
from valor.link_operator.status import status
from valor.link_operator.things import Things
from valor.ros.lateness import Info, timely
from valor.ros.link_loop import serve
from valor.ros.node import ProcessNode, RosSide
from valor.ros.relayed import COMMANDS, Command, Deflated, Word, kind_of, read, worded
from valor.ros.transforms import ODOM
from valor.service import Context

STATUS = 0.2  # between two of them [s]
AHEAD = 0.25  # of robot time, that is shown without another state [s]
KEPT = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_log = logging.getLogger("link_operator")


class LinkOperator:
    """Serves the operator's ROS domain."""

    def __init__(self, context: Context) -> None:
        """Join the operator's domain.

        Raises:
            ConfigurationError: there is none, or it is the robot's.
        """
        settings = context.settings
        if settings.link.domain is None or (not settings.hosts and settings.link.domain == settings.ros_domain_id):
            raise ConfigurationError(f"link: domain: got {settings.link.domain}; expected another than the robot's")
        self._context = context
        self._link = settings.link
        joined = session(context.instance, context.name, context.robot)
        theirs = structs.replace(settings, ros_domain_id=settings.link.domain)
        environment = context.instance.environment()
        knowing = partial(ProcessNode, knows_time=True, others=bool(settings.peers))
        self._side = RosSide(context.name, theirs, environment, context.arguments, node=knowing)
        node, self._layout = self._side.node, Layout(context.robot)
        self._end = OperatorEnd(joined, self._layout, time.monotonic(), fast=True)
        self._fetcher = Fetcher(joined, context.instance.fetched)
        others = [(self._link.robot, port) for port in ports_to_robot(settings)]
        self._carrier = Carrier(self._end, other=others, things=self._fetcher)
        self._things = Things(node, self._end, self._fetcher)
        self._deflated = Deflated(context.robot)
        self._republisher = Republisher(node, context.robot, settings)
        self._fates = Fates()
        self._goals = Goals(node, self._end, self._deflated, self._fates)
        self._progress = Progress(node, f"{settings.frame_prefix}{ODOM}", self._goals.feedback)
        self._beyond = Beyond(context.node, self._end)
        self._rejections = node.create_publisher(Rejection, "flor/controller/rejection", KEPT)
        self._status = node.create_publisher(DiagnosticStatus, "link/status", LATCHED)
        for place, command in enumerate(COMMANDS):
            obeyed = timely(command.name, partial(self._send, place, command), others=node.others)
            node.create_subscription(command.type, command.name, obeyed, 10)
        self._published, self._shown, self._told = -1, (0, 0.0), 0.0
        self._time = 0
        self._side.life.configured()

    def run(self) -> None:
        """Serve until told to stop."""
        serve(self._context, self._side, self._end, self._carrier, self._turn)

    def _turn(self, now: float) -> None:
        for event in self._end.events():
            self._hear(event)
        self._beyond.turn()
        self._show(now)
        self._things.turn(now)

    def _show(self, now: float) -> None:
        state = self._end.state
        if state is not None and state.clock != self._published:
            self._published, self._shown = state.clock, (state.stamp, now)
            self._time = max(self._time, state.stamp * 10**6)
            self._side.node.tell_time(self._time)
            self._republisher.tick(self._time)
            self._republisher.publish(state)
        elif state is not None:
            ahead = min(now - self._shown[1], AHEAD)
            self._time = max(self._time, self._shown[0] * 10**6 + round(1e9 * ahead))
            self._republisher.tick(self._time)
        if now - self._told >= STATUS:
            self._told = now
            told = self._fates.lines(now) | self._things.values(now)
            self._status.publish(status(self._end, self._layout, self._link, now, told))

    def _send(self, place: int, command: Command, message: Any, _info: Info) -> None:
        content = worded(Word.TOPIC, place, self._deflated.pack(message))
        kind, now = kind_of(command, message), time.monotonic()
        try:
            if kind is Kind.STREAM:
                self._end.stream(kind, content, now)
            else:
                self._fates.sent(self._end.send(kind, content, now), command.name)
        except SealError as error:
            self._fates.unsent(command.name, str(error))
            self._refuse(command.name, str(error))

    def _refuse(self, topic: str, why: str) -> None:
        _log.warning("%s not sent: %s", topic, why)
        self._rejections.publish(Rejection(topic=topic, origin="link_operator", reason=why))

    def _hear(self, event: Event) -> None:
        if isinstance(event, Began):
            _log.info("session %d with the robot's end", self._end.session.number)
            self._goals.lose_all("the link began anew; what becomes of it is not known")
            self._fates.lose_all("the link began anew; what became of it is not known")
            self._beyond.lose_all("the link began anew; what became of it is not known")
        elif isinstance(event, GivenUp):
            for number in event.ids:
                if self._beyond.lost(number, "not acknowledged by the robot's side before its deadline"):
                    continue
                name = self._fates.name(number)
                self._goals.given_up(number)
                self._refuse(name or "link", f"command {number}: not acknowledged before its deadline")
        elif isinstance(event, Arrived):
            self._take(event)

    def _take(self, arrived: Arrived) -> None:
        try:
            word, number, content = read(arrived.content)
            if word is Word.ACCEPTED:
                self._goals.accepted(number)
                self._beyond.accepted(number)
            elif word is Word.REFUSED:
                why = content.decode(errors="replace")
                if not self._beyond.lost(number, f"refused: {why}"):
                    self._goals.refuse(number, why)
            elif word is Word.SAID:
                self._beyond.ended(number, content)
            elif word is Word.RESULT:
                self._goals.end(number, content)
            elif word is Word.TOLD:
                self._rejections.publish(self._deflated.unpack(content, Rejection))
            elif word is Word.STEPS:
                self._progress.steps(content)
            elif word is Word.PROGRESS:
                self._progress.plan(number, content)
            elif word is Word.HAND:
                self._progress.hand(number, content)
        except SealError as error:
            _log.warning("%s of the robot's end: %s", arrived.kind.name, error)

    def close(self) -> None:
        """Leave ROS; the robot does what it did."""
        self._carrier.close()
        self._fetcher.close()
        self._goals.close()
        self._side.close()
