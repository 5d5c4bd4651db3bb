"""The station as a service: ears, desk, scene and page, and the loop that turns them thirty times a second."""

from __future__ import annotations

import logging
import time
from math import inf
from pathlib import Path

from msgspec import structs
from viser import ClientHandle, ViserServer

from valor.common.errors import ConfigurationError
from valor.common.instance import Settings
from valor.common.linking import behind
from valor.common.processes import HEAD_CAMERA
from valor.common.topics import GROUND_TRUTH
from valor.common.viewing import LOOPBACK, Viewing, page_port, stop_port
from valor.door.serving import STOP_BUTTON, Guard, inside
from valor.operator_station.commander import Commander
from valor.operator_station.desk import Desk, Visit
from valor.operator_station.drive import Drive
from valor.operator_station.extras import Extras
from valor.operator_station.followers import Followers
from valor.operator_station.front import Front
from valor.operator_station.intake import Intake
from valor.operator_station.joining import Joining
from valor.operator_station.listener import Listener
from valor.operator_station.modes import Modes
from valor.operator_station.parts import Parts
from valor.operator_station.plots import Plots
from valor.operator_station.preview import Previewer
from valor.operator_station.reach import Reach
from valor.operator_station.scene import Scene
from valor.operator_station.simulation import Simulation
from valor.operator_station.topics import Topics
from valor.operator_station.view import View
from valor.operator_station.worker import Worker
from valor.robot.model import full_model
from valor.ros.node import RosSide
from valor.service import Context, quiet_collector

PERIOD = 1.0 / 30.0  # of frames [s]
ALONE = 0.2  # while nobody looks [s]
TEXTS = 6  # frames to a look at the texts

_log = logging.getLogger("operator_station")


class OperatorStation:
    """Serves the page."""

    def __init__(self, context: Context) -> None:
        """Open the page and join ROS.

        Raises:
            ConfigurationError: the port is another's.
        """
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
        self._side.life.configured()
        self._commander.start()

    def _assemble(self, context: Context) -> None:
        settings, robot, node = context.settings, context.robot, self._side.node
        linked = behind(settings)
        camera = not linked and HEAD_CAMERA in settings.asked
        intake = Intake(linked=linked, camera=settings.link.picture if camera else "")
        self._heard, self._listener = intake.heard, Listener(node, intake)
        groups = [group for group in ("left_arm", "right_arm", "left_hand", "right_hand", "neck", "torso")
                  if robot.tables.group(group)]  # fmt: skip
        self._commander = Commander(node, self._side.executor, groups, f"{settings.frame_prefix}odom")
        viewing, port = Viewing.of(context.instance), page_port(settings)
        self._server = _serve(within := inside(viewing, port))
        server, heard = self._server, self._heard
        self._desk = desk = Desk(server, _token(context.instance.operator_token))
        top = "" if linked else stop_button(settings, viewing)
        stop = desk.taking(self._stop_softly) if linked else None
        self._front = Front(server, top, desk.lease.describe, desk.log, stop)
        self._joining = Joining(desk)
        model = full_model(robot, "all")
        world = (settings.world, settings.seed) if settings.variant == "simulation" else None
        self._scene = Scene(server, model, world)
        self._truth = None if linked or world is None else GROUND_TRUTH.subscriber(context.node)
        self._worker = Worker(desk)
        parts = Parts(server, desk, self._commander, heard, self._scene)
        tabs = server.gui.add_tab_group()
        arms = any(robot.tables.group(f"{side}_arm") for side in ("left", "right"))
        with tabs.add_tab("Drive"):
            self._drive = Drive(parts, Modes(arms=arms))
        with tabs.add_tab("Arms"):
            previewer = Previewer(full_model(robot, "collision"))
            self._reach = Reach(parts, previewer)
        with tabs.add_tab("Plots"):
            self._plots = Plots(server, heard, source=Topics(node, settings.namespace))
        with tabs.add_tab("More"):
            self._followers = Followers(server, self._scene)
            Extras(parts, context, self._worker)
        with tabs.add_tab("Simulation"):
            self._simulation = Simulation(parts, context, self._worker)
        self._view: View | None = None
        if linked or camera:
            with tabs.add_tab("View"):
                self._view = View(server, linked)
        others = {} if linked else {STOP_BUTTON: stop_port(settings)}
        self._guard = Guard(context.instance, settings, port, within, others)
        self._url = viewing.url(port)
        server.on_client_connect(self._arrived)
        server.on_client_disconnect(self._departed)

    def _stop_softly(self, visit: Visit) -> None:
        """For every viewer, however old the press: what became of it comes with the link's status."""
        self._commander.stop_softly()
        self._desk.log.begin("stop, through the link", f"viewer {visit.viewer}", visit.age, time.monotonic(), inf)

    def _arrived(self, client: ClientHandle) -> None:
        self._desk.arrived(client)
        self._joining.arrived(client)
        _log.info("viewer %d is there", client.client_id)

    def _departed(self, client: ClientHandle) -> None:
        self._desk.departed(client)
        _log.info("viewer %d is gone", client.client_id)

    def run(self) -> None:
        """Draw and obey until told to stop."""
        quiet_collector()
        self._statistics.state("ready")
        self._side.life.tell(True)
        _log.info("%s", self._url)
        frame, due = 0, time.monotonic()
        while not self._stopping.is_set():
            began = time.perf_counter()
            self._turn(frame, time.monotonic())
            frame += 1
            self._statistics.cycle(began)
            period = PERIOD if self._server.get_clients() else ALONE
            due = max(due + period, time.monotonic())
            self._stopping.wait(due - time.monotonic())

    def _turn(self, frame: int, now: float) -> None:
        heard, wall = self._heard, time.time()
        self._listener.look(now)
        if self._truth is not None and (received := self._truth.latest()) is not None:
            heard.fixtures = received.message.fixture_position
        self._desk.turn()
        self._drive.turn(now)
        self._plots.note(now, wall)
        with self._server.atomic():
            self._scene.draw(heard, now)
        if frame % TEXTS == 0:
            self._commander.expire(now)
            self._front.draw(heard, now, wall)
            self._drive.draw()
            self._plots.draw(wall)
            self._followers.draw()
            self._simulation.draw()
            if self._view is not None:
                self._view.draw(heard, now)

    def close(self) -> None:
        """Leave ROS; the robot does what it did."""
        self._guard.close()
        self._server.stop()
        self._commander.close()
        self._worker.close()
        self._side.close()


def stop_button(settings: Settings, viewing: Viewing) -> str:
    """The stop's own page, as HTML within this one."""
    url = STOP_BUTTON if viewing.secured else viewing.url(stop_port(settings))
    return f'<iframe title="stop" src="{url}" style="width:100%;height:92px;border:0"></iframe>'


def _serve(port: int) -> ViserServer:
    """A page on the loopback interface.

    Raises:
        ConfigurationError: the port is another's.
    """
    server = ViserServer(host=LOOPBACK, port=port, verbose=False)
    if server.get_port() != port:
        server.stop()
        raise ConfigurationError(f"port {port} of {LOOPBACK}: somebody else has it")
    return server


def _token(file: Path) -> str:
    """By which a viewer becomes the operator; empty: there is none, and nobody does."""
    try:
        return file.read_text().strip()
    except OSError as error:
        _log.warning("%s: %s: nobody can operate", file, error.strerror)
        return ""
