"""Panels: status, control, cameras, recorder, and the robot's view."""

from __future__ import annotations

import io
import logging
import time
from collections.abc import Callable
from functools import partial
from html import escape

import numpy as np
from PIL import Image, UnidentifiedImageError
from viser import ClientHandle, GuiImageHandle, GuiInputHandle, GuiTabHandle, ViserServer

from valor.common.balance_controllers import in_control
from valor.operator_station.commands.log import CommandLog
from valor.operator_station.commands.queue import CommandQueue, UserEvent
from valor.operator_station.robot.snapshot import RobotSnapshot
from valor.operator_station.scene.scene import Scene

WIDTH = 310.0  # of the robot's panel [px]
LINK_OLD = 1.5  # age of the link status [s]
GREY, BLACK, RED, AMBER = "#9a9a9a", "#222", "#c9211e", "#b36b00"
_LEVELS = (BLACK, AMBER, RED, GREY)
SHOWN = {"joints": "joints", "pelvis": "pelvis", "motion": "behavior", "mode": "control mode", "com": "balance"}


class StatusPanel:
    """Panel of all viewers: state and news."""

    def __init__(self, server: ViserServer, who: Callable[[], str], commands: CommandLog) -> None:
        """``who`` names the operator."""
        gui = server.gui
        gui.set_panel_label("valor: operator station")
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
        gui.main_panel.dock_right()
        robot = gui.add_panel(order=-1.0)  # separate, so that the state does not scroll
        with robot.add_tab("Robot") as self.tab:
            self._state = gui.add_html("", order=0.0)
            self._news = gui.add_html("", order=20.0)
        robot.dock_left()
        robot.set_width(WIDTH)
        robot.expand()  # on a phone, too
        self._who, self._commands = who, commands

    def draw(self, heard: RobotSnapshot, now: float) -> None:
        """Update; ``now`` is monotonic [s]."""
        self._state.content, self._news.content = self._markup(heard, now), _news(heard, self._commands)

    def _markup(self, heard: RobotSnapshot, now: float) -> str:
        ages, states = heard.ages, heard.states
        linked = heard.link is not None
        level, status = heard.status
        active = in_control(heard.controllers, heard.behavior) if heard.controllers else ""
        mode_color = GREY if ages.old("mode", now) else BLACK
        lines = [
            f'<b style="font-size:17px;color:{mode_color}">{escape(heard.mode.current) or "mode not known"}</b> '
            f'<span style="color:{_LEVELS[min(level, 3)]}">{escape(status)}</span>',
            _colored(
                " · ".join(f"{name} <b>{escape(states.get(name, '?'))}</b>" for name in
                           ("behavior", "locomotion", "manipulation", "attention"))
                + (f" · controller <b>{escape(active)}</b>" if active else ""),
                ages.old("motion", now),
            ),
            f"<b>{escape(self._who())}</b>",
            " · ".join(
                _colored(f"{label} {ages.text(name, now)}", ages.old(name, now))
                for name, label in SHOWN.items()
                if not (linked and name == "com")  # not sent over the link
            ),
        ]  # fmt: skip
        if heard.link is not None:
            lines += [_colored(escape(line), ages.age("link", now) > LINK_OLD) for line in heard.link.lines()]
        if hands := _hands(heard):
            lines.append(escape(hands))
        rows = "".join(f"<div>{line}</div>" for line in lines)
        return f'<div id="state" style="font:13px/1.45 system-ui;padding:4px 8px">{rows}</div>'


def _hands(heard: RobotSnapshot) -> str:
    """Status of active hand goals."""
    return " · ".join(
        f"{name.replace('_', ' ')} {state.replace('_', ' ')}, {100.0 * off:.1f} cm off" + (f": {why}" if why else "")
        for name, (state, why, off) in heard.hands.items()
        if state != "idle"
    )


def _news(heard: RobotSnapshot, log: CommandLog) -> str:
    commands = [command.line() for command in list(log.commands)[:6]]
    told = [f"{time.strftime('%H:%M:%S', time.localtime(when))} {text}" for when, text in list(heard.news)[:6]]
    parts = (("Commands", "commands", commands), ("Refusals and changes", "news", told))
    return "".join(
        f'<div id="{name}" style="font:12px/1.4 system-ui;padding:4px 8px"><b>{title}</b>'
        + "".join(f"<div>{escape(line)}</div>" for line in lines or ["none"])
        + "</div>"
        for title, name, lines in parts
    )


def _colored(text: str, old: bool) -> str:
    return f'<span style="color:{GREY if old else BLACK}">{text}</span>'


FAR = 0.05  # distance after which the cameras follow [m]


class Viewers:
    """Folder in each viewer's panel to take and return control, and its camera, which follows the pelvis."""

    def __init__(self, server: ViserServer, desk: CommandQueue, scene: Scene) -> None:
        self._server, self._desk, self._scene = server, desk, scene
        self._at = scene.body.data.qpos[:2].copy()
        self._follows: dict[int, GuiInputHandle[bool]] = {}

    def arrived(self, client: ClientHandle) -> None:
        """Add the folder for a viewer."""
        gui, desk = client.gui, self._desk
        self._follows[client.client_id] = gui.add_checkbox("the camera follows the robot", True)
        with gui.add_folder("Operator", order=-10.0, expand_by_default=True):
            name = gui.add_text("name", f"viewer {client.client_id}")
            token = gui.add_text("token", "", hint="in the file operator.token of the instance's folder")

            def claim(visit: UserEvent, *, over: bool) -> None:
                desk.claim(visit, str(name.value), str(token.value), over=over)
                token.value = ""  # type: ignore[misc]  # it has a setter

            for label, act in (("Take control", partial(claim, over=False)), ("Take over", partial(claim, over=True)),
                               ("Give back", desk.release)):  # fmt: skip
                gui.add_button(label).on_click(desk.taking(act, anyone=True))

    def departed(self, client: ClientHandle) -> None:
        """Forget a viewer."""
        self._follows.pop(client.client_id, None)

    def draw(self) -> None:
        """Move the cameras."""
        here = self._scene.body.data.qpos[:2]
        way = here - self._at
        if np.linalg.norm(way) < FAR:
            return
        self._at = here.copy()
        for number, client in self._server.get_clients().items():
            follow = self._follows.get(number)
            if follow is not None and follow.value and client.camera.update_timestamp:  # position received
                client.camera.position = np.asarray(client.camera.position) + np.array((*way, 0.0))


WIDEST = 640  # size sent to viewers [px]
QUALITY = 75  # JPEG quality
NONE = "No picture has come yet."
NONE_THROUGH_LINK = "No picture has come yet: one comes when the fast channel opens, if the robot has a camera."
_log = logging.getLogger("operator_station")


class View:
    """Latest picture of the robot, with its age."""

    def __init__(self, server: ViserServer, tab: GuiTabHandle, linked: bool) -> None:
        self._gui = server.gui
        with tab, self._gui.add_folder("View", order=10.0) as self._folder:
            self._text = self._gui.add_markdown(NONE_THROUGH_LINK if linked else NONE)
        self._image: GuiImageHandle | None = None
        self._shown: bytes = b""

    def draw(self, heard: RobotSnapshot, now: float) -> None:
        """Update; ``now`` is monotonic [s]."""
        if heard.picture and heard.picture is not self._shown:
            self._shown = heard.picture
            self._show(heard.picture)
        if self._image is not None:
            self._text.content = f"The picture is {heard.ages.text('picture', now)}."

    def _show(self, picture: bytes) -> None:
        try:
            with Image.open(io.BytesIO(picture)) as opened:
                opened.thumbnail((WIDEST, WIDEST))
                pixels = np.asarray(opened.convert("RGB"))
        except (UnidentifiedImageError, Image.DecompressionBombError, OSError, ValueError, SyntaxError) as error:
            _log.warning("the robot's picture is none: %s", error)
            return
        if self._image is None:
            with self._folder:
                self._image = self._gui.add_image(pixels, format="jpeg", jpeg_quality=QUALITY)
        else:
            self._image.image = pixels
