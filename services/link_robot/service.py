"""The loop: datagrams in, what they say to ROS; what ROS says out."""

from __future__ import annotations

import logging
import time

from valor.common.behaviors import STEPPING_MODES, WALKING_MODES
from valor.common.linking import robot_ports
from valor.link.bulk.giver import Giver
from valor.link.carrier import Carrier
from valor.link.end import Arrived, Began
from valor.link.ends import RobotEnd
from valor.link.fields import Layout
from valor.link.joining import session
from valor.link.state import RobotState
from valor.link_robot.obedience import Obedience
from valor.link_robot.observer import Observer
from valor.link_robot.reporter import Reporter
from valor.link_robot.shelf import RobotShelf
from valor.link_robot.view import View
from valor.ros.link_loop import serve
from valor.ros.node import RosSide
from valor.service import Context

_log = logging.getLogger("link_robot")


class LinkRobot:
    """Serves one operator's end."""

    def __init__(self, context: Context) -> None:
        """Join ROS and listen.

        Raises:
            ConfigurationError: there are no keys, or the ports are another's.
        """
        self._context = context
        self._settings = context.settings.link
        joined = session(context.instance, context.name, context.robot)
        environment = context.instance.environment()
        self._side = RosSide(context.name, context.settings, environment, context.arguments)
        self._observer = Observer(self._side.node, context.robot)
        layout = Layout(context.robot)
        self._end = RobotEnd(joined, layout, self._state, time.monotonic(), fast=True)
        own = [(self._settings.listen, port) for port in robot_ports(context.settings)]
        self._view = View(self._side.node, self._end, self._settings.picture)
        self._shelf = RobotShelf(context.instance.bags, self._view.newest)
        self._giver = Giver(joined, self._shelf)
        self._carrier = Carrier(self._end, own=own, things=self._giver)
        self._obedience = Obedience(self._side.node, self._end, context.robot)
        self._reporter = Reporter(self._end, self._observer, self._obedience)
        self._lost = True  # nobody has been heard yet
        self._side.life.configured()

    def run(self) -> None:
        """Serve until told to stop."""
        serve(self._context, self._side, self._end, self._carrier, self._turn)

    def _state(self) -> RobotState | None:
        if (state := self._observer.state()) is not None:
            state.velocity_age = time.monotonic() - self._obedience.streamed
        return state

    def _turn(self, now: float) -> None:
        for event in self._end.events():
            if isinstance(event, Arrived):
                self._obedience.obey(event)
            elif isinstance(event, Began):
                _log.info("session %d with the operator's end", self._end.session.number)
                self._obedience.begin()
                self._reporter.begin()
        for rejection in self._observer.rejections:
            self._obedience.tell(rejection)
        self._observer.rejections.clear()
        self._reporter.tell(now)
        self._obedience.turn(now)
        self._watch(now)

    def _watch(self, now: float) -> None:
        """Once when the operator's end falls silent: what the settings say."""
        lost = self._end.silent(now) > self._settings.lost_after
        self._view.listen(not lost)
        if lost and not self._lost:
            self._observer.look()
            state = self._observer.state()
            walks = state is not None and state.mode in STEPPING_MODES | WALKING_MODES
            _log.warning(
                "the operator's end is silent for %g s: %s", self._settings.lost_after, self._settings.when_lost
            )
            if walks and self._settings.when_lost == "stop":
                self._obedience.stop_softly()
        self._lost = lost

    def close(self) -> None:
        """Leave ROS; the robot does what it did."""
        self._carrier.close()
        self._giver.close()
        self._shelf.close()
        self._side.close()
