"""The top of the page: who operates, how the robot is, how old that is, and what was said."""

from __future__ import annotations

import html
import time
from collections.abc import Callable
from typing import Any

from viser import ViserServer

from valor.operator_station.commands import CommandLog
from valor.operator_station.heard import Heard

WIDTH = 310.0  # of the panel of the robot [px]
LINK_OLD = 1.5  # of what the link says of itself [s]
MINUTES = 2.0  # that the timeline of modes shows
GREY, BLACK, RED, AMBER = "#9a9a9a", "#222", "#c9211e", "#b36b00"
_LEVELS = (BLACK, AMBER, RED, GREY)
SHOWN = {"joints": "joints", "pelvis": "pelvis", "motion": "behavior", "mode": "control mode", "com": "balance"}


class Front:
    """What all viewers see at the top and at the bottom of the panel."""

    def __init__(
        self,
        server: ViserServer,
        top: str,
        who: Callable[[], str],
        commands: CommandLog,
        stop: Callable[[Any], Any] | None = None,
    ) -> None:
        """Lay it out.

        Args:
            server: of the page.
            top: HTML above all else.
            who: operates, in one line.
            commands: that were given.
            stop: is called by a button that stops the robot through the link; None: ``top`` has the stop.
        """
        gui = server.gui
        gui.set_panel_label("valor: operator station")
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
        gui.main_panel.dock_right()
        robot = gui.add_panel(order=-1.0)  # apart: the stop and the state must not scroll away with what is pressed
        with robot.add_tab("Robot"):
            if top:
                gui.add_html(top)
            if stop is not None:
                gui.add_button("Stop, through the link", color="red").on_click(stop)
            self._state = gui.add_html("")
            self._news = gui.add_html("")
        robot.dock_left()
        robot.set_width(WIDTH)
        self._who, self._commands = who, commands
        self._shown: dict[int, str] = {}

    def draw(self, heard: Heard, now: float, wall: float) -> None:
        """Say how things are; ``now``: of the ages, ``wall``: of the timeline [s]."""
        self._put(self._state, self._markup(heard, now, wall))
        self._put(self._news, _news(heard, self._commands))

    def _put(self, handle: Any, content: str) -> None:
        """What has not changed is not sent."""
        if self._shown.get(id(handle)) != content:
            self._shown[id(handle)] = content
            handle.content = content

    def _markup(self, heard: Heard, now: float, wall: float) -> str:
        ages, states = heard.ages, heard.states
        linked = heard.link is not None
        level, status = heard.status
        mode_color = GREY if ages.old("mode", now) else BLACK
        lines = [
            f'<b style="font-size:17px;color:{mode_color}">{_text(heard.mode.current or "control mode not known")}</b> '
            f'<span style="color:{_LEVELS[min(level, 3)]}">{_text(status)}</span>',
            _colored(
                " · ".join(f"{name} <b>{_text(states.get(name, '?'))}</b>" for name in
                           ("behavior", "locomotion", "manipulation", "attention")),
                ages.old("motion", now),
            ),
            f"<b>{_text(self._who())}</b>",
            " · ".join(
                _colored(f"{label} {ages.text(name, now)}", ages.old(name, now))
                for name, label in SHOWN.items()
                if not (linked and name == "com")  # the link does not carry it
            ),
        ]  # fmt: skip
        if heard.link is not None:
            lines += [_colored(_text(line), ages.age("link", now) > LINK_OLD) for line in heard.link.lines()]
        if hands := _hands(heard):
            lines.append(_text(hands))
        bands = heard.modes.markup(wall - 60.0 * MINUTES, wall)
        rows = "".join(f"<div>{line}</div>" for line in lines)
        return f'<div id="state" style="font:13px/1.45 system-ui;padding:4px 8px">{rows}{bands}</div>'


def _hands(heard: Heard) -> str:
    """What became of the hands' goals; empty: none has one."""
    return " · ".join(
        f"{name.replace('_', ' ')} {state.replace('_', ' ')}, {100.0 * off:.1f} cm off" + (f": {why}" if why else "")
        for name, (state, why, off) in heard.hands.items()
        if state != "idle"
    )


def _news(heard: Heard, log: CommandLog) -> str:
    commands = [command.line() for command in list(log.commands)[:6]]
    told = [f"{time.strftime('%H:%M:%S', time.localtime(when))} {text}" for when, text in list(heard.news)[:6]]
    parts = (("Commands", "commands", commands), ("Refusals and changes", "news", told))
    return "".join(
        f'<div id="{name}" style="font:12px/1.4 system-ui;padding:4px 8px"><b>{title}</b>'
        + "".join(f"<div>{_text(line)}</div>" for line in lines or ["none"])
        + "</div>"
        for title, name, lines in parts
    )


def _colored(text: str, old: bool) -> str:
    return f'<span style="color:{GREY if old else BLACK}">{text}</span>'


def _text(text: str) -> str:
    return html.escape(text)
