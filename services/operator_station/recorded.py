"""``python -m valor.operator_station.recorded BAG``: the page on a recording. Nothing can be commanded."""

from __future__ import annotations

import argparse
import contextlib
import html
import io
import logging
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from viser import ViserServer

from valor.bags.origin import origin_of, robot_of
from valor.common.errors import ValorError
from valor.common.processes import EXIT_CONFIGURATION
from valor.common.resources import robot_folder
from valor.common.viewing import LOOPBACK, RECORDED_PORT
from valor.operator_station.commands import CommandLog
from valor.operator_station.followers import Followers
from valor.operator_station.front import Front
from valor.operator_station.intake import Intake
from valor.operator_station.player import Player, wanted_of
from valor.operator_station.plots import Plots
from valor.operator_station.scene import Scene
from valor.operator_station.tape import Tape
from valor.robot.description import RobotDescription
from valor.robot.model import full_model

PERIOD = 1.0 / 30.0  # of frames [s]
TEXTS = 6  # frames to a look at the texts
FRAME = 1.0 / 30.0  # of a single step [s]
SPEEDS = ("0.1", "0.25", "0.5", "1", "2", "5", "10")
LONGEST = 0.2  # that one turn makes up for [s]
WORDS = 60  # of an event, in characters
CHOOSE = "go to …"  # no event is chosen
DRAGGED = 1.0  # after somebody moved it, the time is left alone [s]


class Controls:
    """Play, pause, seek, speed; every viewer's, for all. What they ask for is done by the loop."""

    def __init__(self, server: ViserServer, player: Player, tape: Tape) -> None:
        self._player, self._tape = player, tape
        self._line: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._touched = 0.0
        gui = server.gui
        with gui.add_folder("Recording"):
            self._told = gui.add_markdown("")
            self._time: Any = gui.add_slider("time [s]", 0.0, 1.0, 0.01, 0.0)
            self._play = gui.add_button("Pause")
            gui.add_button("A frame back").on_click(lambda _: self._line.put(lambda: player.step(-FRAME)))
            gui.add_button("A frame on").on_click(lambda _: self._line.put(lambda: player.step(FRAME)))
            speed = gui.add_dropdown("speed", SPEEDS, initial_value="1")
            self._event: Any = gui.add_dropdown("event", (CHOOSE,), visible=False)
        self._events: dict[str, float] = {}  # by what is said of each, when it was [s]
        self._play.on_click(lambda _: self._line.put(self._toggle))
        self._time.on_update(self._dragged)
        self._event.on_update(self._chosen)
        speed.on_update(lambda _: self._line.put(lambda: setattr(player, "speed", float(speed.value))))

    def turn(self) -> None:
        """Do what was asked for."""
        while True:
            try:
                act = self._line.get_nowait()
            except queue.Empty:
                return
            act()

    def draw(self) -> None:
        """Say where the recording is."""
        player, tape = self._player, self._tape
        label = "Pause" if player.playing else "Play"
        if self._play.label != label:
            self._play.label = label
        length = round(player.length, 2)
        self._time.max = max(self._time.max, length)
        if time.monotonic() - self._touched > DRAGGED and abs(self._time.value - player.seconds) >= 0.01:
            self._time.value = round(player.seconds, 2)
        text = f"{player.seconds:.2f} of {player.length:.1f} s" + ("" if tape.whole else ", being read …")
        text += "".join(f"\n\n{html.escape(line)}" for line in tape.damage[:3])
        if self._told.content != text:
            self._told.content = text
        if len(tape.events) != len(self._events):
            events = sorted(tape.events, key=lambda event: event.stamp)
            times = [player.place(event.stamp) for event in events]
            self._events = {
                f"{i}. {seconds:.2f} s, {event.text[:WORDS]}": seconds
                for i, (seconds, event) in enumerate(zip(times, events, strict=True), 1)
            }
            self._event.options, self._event.visible = (CHOOSE, *self._events), True

    def refresh(self) -> None:
        """Play again what leads here, for whoever wants its past."""
        self._line.put(lambda: self._player.seek(self._player.seconds))

    def _toggle(self) -> None:
        player = self._player
        if not player.playing and self._tape.whole and player.seconds >= player.length:
            player.seek(0.0)
        player.playing = not player.playing

    def _chosen(self, event: Any) -> None:
        seconds = self._events.get(self._event.value)
        if event.client_id is not None and seconds is not None:
            self._line.put(lambda: self._player.seek(seconds))

    def _dragged(self, event: Any) -> None:
        if event.client_id is None:  # our own
            return
        self._touched = time.monotonic()
        place = float(self._time.value)
        self._line.put(lambda: self._player.seek(place))


class Recorded:
    """The page."""

    def __init__(self, bag: Path, robot: Path | None, port: int) -> None:
        """Open bag and page.

        Raises:
            ValorError: there is no bag, or of a robot that is not known.
        """
        origin = origin_of(bag)
        description = RobotDescription.load(robot or robot_of(bag, origin))
        intake = Intake(recorded=True)
        self._tape = Tape(bag, wanted_of(intake))
        with contextlib.redirect_stdout(io.StringIO()):  # of viser's own words
            self._server = server = ViserServer(host=LOOPBACK, port=port, label=bag.name, verbose=False)
        top = (
            f'<div id="recording" style="font:15px/1.5 system-ui;padding:6px 8px;background:#fff3cd">A recording: '
            f"<b>{html.escape(bag.name)}</b>. Nothing can be commanded.</div>"
        )
        began = origin.get("started", "")[:19].replace("T", " ")
        about = " ".join(filter(None, (description.name, origin.get("instance", ""), began)))
        self._front = Front(server, top, lambda: about, CommandLog())
        world = (origin["world"], int(origin.get("seed", "0"))) if origin.get("world") else None
        self._scene = Scene(server, full_model(description, "all"), world)
        self._player = player = Player(self._tape, intake)
        self._controls = Controls(server, player, self._tape)
        tabs = server.gui.add_tab_group()
        with tabs.add_tab("Plots"):
            self._plots = Plots(server, intake.heard, self._controls.refresh)
        player.sampled, player.forgotten, player.past = self._plots.note, self._plots.forget, self._plots.past
        with tabs.add_tab("More"):
            self._followers = Followers(server, self._scene)

    @property
    def port(self) -> int:
        """That the page has."""
        return int(self._server.get_port())

    def run(self, stopping: threading.Event) -> None:
        """Play until told to stop."""
        heard, player = self._player.intake.heard, self._player
        frame, before = 0, time.monotonic()
        while not stopping.is_set():
            now = time.monotonic()
            self._controls.turn()
            player.advance(min(now - before, LONGEST))
            before = now
            with self._server.atomic():
                self._scene.draw(heard, player.wall)
            if frame % TEXTS == 0:
                self._front.draw(heard, player.wall, player.wall)
                self._controls.draw()
                self._plots.draw(player.wall)
                self._followers.draw()
            frame += 1
            stopping.wait(max(0.0, now + PERIOD - time.monotonic()))

    def close(self) -> None:
        """Let go of bag and port."""
        self._server.stop()
        self._tape.close()


def main() -> int:
    """Serve until SIGTERM or SIGINT."""
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
    parser = argparse.ArgumentParser(prog="python -m valor.operator_station.recorded", description=__doc__)
    parser.add_argument("bag", type=Path)
    parser.add_argument("--robot", default="", help="its name or folder; as the bag says unless given")
    parser.add_argument("--port", type=int, default=RECORDED_PORT, help="the next that is free from there on")
    given = parser.parse_args()
    stopping = threading.Event()
    for signum in (signal.SIGTERM, signal.SIGINT):
        signal.signal(signum, lambda *_: stopping.set())
    try:
        page = Recorded(given.bag, robot_folder(given.robot) if given.robot else None, given.port)
    except ValorError as error:
        print(error, file=sys.stderr)
        return EXIT_CONFIGURATION
    print(f"page: http://{LOOPBACK}:{page.port}/", flush=True)
    page.run(stopping)
    page.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
