"""Loop of the robot's end of the link."""

import logging
import time

from valor.common.behaviors import STEPPING_MODES, WALKING_MODES
from valor.common.linking import robot_ports
from valor.link.endpoint import Arrived, SessionStarted
from valor.link.endpoints import RobotEndpoint
from valor.link.fields import Layout
from valor.link.picture import Picture
from valor.link.state import RobotState
from valor.link.udp_transport import UdpTransport
from valor.link_robot.command_executor import CommandExecutor, Reporter
from valor.link_robot.observer import Observer, View
from valor.ros.link_loop import create_session, serve
from valor.ros.node import RosSide
from valor.service import Context

_log = logging.getLogger("link_robot")


class LinkRobot:
    """Serves one operator's end."""

    def __init__(self, context: Context) -> None:
        """Join ROS and open the sockets. Raises ConfigurationError: no keys, or a port is in use."""
        self._context = context
        self._settings = context.settings.link
        session = create_session(context.instance, context.name, context.robot)
        environment = context.instance.environment()
        self._side = RosSide(context.name, context.settings, environment, context.arguments)
        self._observer = Observer(self._side.node, context.robot)
        self._view = View(self._side.node, self._settings.picture)
        self._end = RobotEndpoint(
            session,
            Layout(context.robot),
            self._state,
            time.monotonic(),
            fast=True,
            picture=self._picture,
            rate=self._settings.rate,
        )
        own = [(self._settings.listen, port) for port in robot_ports(context.settings)]
        self._transport = UdpTransport(self._end, own=own)
        self._executor = CommandExecutor(self._side.node, self._end, context.robot)
        self._reporter = Reporter(self._end, self._observer, self._executor)
        self._lost = True  # no operator so far
        self._side.life.configure()

    def run(self) -> None:
        """Serve until the process is stopped."""
        serve(self._context, self._side, self._end, self._transport, self._turn)

    def _state(self) -> RobotState | None:
        if (state := self._observer.state()) is not None:
            state.velocity_age = time.monotonic() - self._executor.velocity_published_at
        return state

    def _picture(self) -> Picture | None:
        return self._view.latest(self._end.clock(time.monotonic()))

    def _turn(self, now: float) -> None:
        for event in self._end.events():
            if isinstance(event, Arrived):
                self._executor.execute(event)
            elif isinstance(event, SessionStarted):
                _log.info("session %d with the operator's end", self._end.session.number)
                self._executor.begin_session()
                self._reporter.begin_session()
        for rejection in self._observer.rejections:
            self._executor.report(rejection)
        self._observer.rejections.clear()
        self._reporter.turn(now)
        self._check_operator(now)

    def _check_operator(self, now: float) -> None:
        """React once when the operator's end times out, as configured."""
        lost = self._end.silence(now) > self._settings.lost_after
        self._view.subscribe(not lost)
        if lost and not self._lost:
            self._observer.take()
            state = self._observer.state()
            walks = state is not None and state.mode in STEPPING_MODES | WALKING_MODES
            _log.warning(
                "no datagram of the operator's end for %g s: %s", self._settings.lost_after, self._settings.when_lost
            )
            if walks and self._settings.when_lost == "stop":
                self._executor.soft_stop()
        self._lost = lost

    def close(self) -> None:
        """Leave ROS; the robot continues."""
        self._transport.close()
        self._side.close()
