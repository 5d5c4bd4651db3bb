"""The view of the robot and the loop that updates it; controls exist for the operator alone."""

from __future__ import annotations

import logging
import time
from pathlib import Path

from msgspec import structs
from viser import ClientHandle

from valor.common.linking import behind
from valor.common.processes import HEAD_CAMERA
from valor.common.topics import GROUND_TRUTH
from valor.common.viewing import scene_port, url
from valor.operator_station.commands.commander import Commander
from valor.operator_station.commands.queue import CommandQueue
from valor.operator_station.gate import Gate
from valor.operator_station.robot.intake import Intake
from valor.operator_station.robot.modes import Modes
from valor.operator_station.scene.scene import Scene
from valor.operator_station.tabs import StationContext
from valor.operator_station.tabs.drive import Drive
from valor.operator_station.tabs.preview import Previewer
from valor.operator_station.tabs.reach import Reach
from valor.operator_station.tabs.status import StatusPanel, View, Viewers
from valor.robot.model import full_model
from valor.ros.node import RosSide
from valor.service import Context, quiet_collector

PERIOD = 1.0 / 30.0  # of frames [s]
ALONE = 0.2  # without viewers [s]
TEXTS = 6  # frames per update of the texts
REPORTED = 300  # least frames between reports of failed ones

_log = logging.getLogger("operator_station")


class Controls:
    """Tabs of the operator, from the start to the end of the operation."""

    def __init__(self, parts: StationContext, modes: Modes, previewer: Previewer) -> None:
        self._client = parts.client
        self._tabs = tabs = parts.client.gui.add_tab_group(order=-5.0)
        with tabs.add_tab("Drive"):
            self.drive = Drive(parts, modes)
        with tabs.add_tab("Arms"):
            self._reach = Reach(parts, previewer)

    def close(self) -> None:
        """Remove all of them."""
        self.drive.close()
        self._reach.close()
        self._client.scene.remove_click_callback()
        self._tabs.remove()


class OperatorStation:
    """Serves the view."""

    def __init__(self, context: Context) -> None:
        """Open the server and join ROS; raises ``ConfigurationError`` if another process has the port."""
        settings = context.settings
        self._stopping, self._statistics = context.stopping, context.statistics
        joined = settings
        if settings.link.domain is not None and behind(settings):
            joined = structs.replace(settings, ros_domain_id=settings.link.domain)
        self._side = RosSide(context.name, joined, context.instance.environment(), context.arguments, sim_time=False)
        try:
            self._assemble(context)
        except BaseException:
            self._side.close()
            raise
        self._side.life.configure()
        self._commander.start()

    def _assemble(self, context: Context) -> None:
        settings, robot, node = context.settings, context.robot, self._side.node
        linked = behind(settings)
        camera = not linked and HEAD_CAMERA in settings.asked
        self._intake = Intake(linked=linked, camera=settings.link.picture if camera else "")
        self._intake.listen(node)
        self._heard = self._intake.heard
        groups = [group for group in ("left_arm", "right_arm", "left_hand", "right_hand", "neck", "torso")
                  if robot.tables.group(group)]  # fmt: skip
        self._commander = Commander(node, self._side.executor, groups, f"{settings.frame_prefix}odom")
        port = scene_port(settings)
        self._desk = desk = CommandQueue(_token(context.instance.operator_token))
        gate = Gate(port, desk.lease.viewer)
        self._server = desk.server = server = gate.open()
        self._front = StatusPanel(server, desk.lease.describe, desk.log)
        world = (settings.world, settings.seed) if settings.variant == "simulation" else None
        self._scene = Scene(server, full_model(robot, "all"), world)
        self._viewers = Viewers(server, desk, self._scene)
        self._truth = None if linked or world is None else GROUND_TRUTH.subscriber(context.node)
        self._previewer = Previewer(full_model(robot, "collision"))
        self._modes = Modes(arms=any(robot.tables.group(f"{side}_arm") for side in ("left", "right")))
        self._view = View(server, self._front.tab, linked) if linked or camera else None
        self._url = url(port)
        self._controls: Controls | None = None
        desk.began, desk.ended = self._give_controls, self._take_controls
        server.on_client_connect(self._arrived)
        server.on_client_disconnect(self._departed)

    def _give_controls(self, client: ClientHandle) -> None:
        parts = StationContext(client, self._desk, self._commander, self._heard, self._scene)
        self._controls = Controls(parts, self._modes, self._previewer)

    def _take_controls(self) -> None:
        if self._controls is not None:
            self._controls.close()
            self._controls = None

    def _arrived(self, client: ClientHandle) -> None:
        self._desk.arrived(client)
        self._viewers.arrived(client)
        _log.info("viewer %d is there", client.client_id)

    def _departed(self, client: ClientHandle) -> None:
        self._desk.departed(client)
        self._viewers.departed(client)
        _log.info("viewer %d is gone", client.client_id)

    def run(self) -> None:
        """Draw and process commands until stopped."""
        quiet_collector()
        self._statistics.state("ready")
        self._side.life.set_ready(True)
        _log.info("%s", self._url)
        frame, reported, due = 0, -REPORTED, time.monotonic()
        while not self._stopping.is_set():
            began = time.perf_counter()
            try:
                self._turn(frame, time.monotonic())
            except Exception:  # what one viewer sends must not end the view of all
                if frame - reported >= REPORTED:
                    _log.exception("a frame failed")
                    reported = frame
            frame += 1
            self._statistics.cycle(began)
            period = PERIOD if self._server.get_clients() else ALONE
            due = max(due + period, time.monotonic())
            self._stopping.wait(due - time.monotonic())

    def _turn(self, frame: int, now: float) -> None:
        heard = self._heard
        self._intake.look(now)
        if self._truth is not None and (received := self._truth.latest()) is not None:
            heard.fixtures = received.message.fixture_position
        self._desk.turn()
        if self._controls is not None:
            self._controls.drive.turn(now)
        with self._server.atomic():
            self._scene.draw(heard, now)
        if frame % TEXTS == 0:
            self._commander.expire(now)
            self._front.draw(heard, now)
            self._viewers.draw()
            if self._controls is not None:
                self._controls.drive.draw()
            if self._view is not None:
                self._view.draw(heard, now)

    def close(self) -> None:
        """Leave ROS; running commands continue."""
        self._take_controls()
        self._server.stop()
        self._commander.close()
        self._side.close()


def _token(file: Path) -> str:
    """Token that makes a viewer the operator; empty without one: then no viewer can be."""
    try:
        return file.read_text().strip()
    except OSError as error:
        _log.warning("%s: %s: nobody can operate", file, error.strerror)
        return ""
