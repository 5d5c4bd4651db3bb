"""Curves that people choose, with the bands of the control modes under each."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from viser import ViserServer, uplot

from valor.operator_station.heard import Heard
from valor.operator_station.signals import commanded, position, signals

SECONDS = 20.0  # that a plot shows
RATE = 15.0  # samples kept [1/s]
DRAWN = 0.5  # between two drawings of a plot [s]
COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
NEW = "a new plot"


class Source(Protocol):
    """Who has signals beside those that the page hears anyway."""

    def values(self) -> Mapping[str, float]:
        """The newest of each that is listened to, by name with its unit."""

    def offered(self) -> Sequence[str]:
        """What can be listened to."""

    def listen(self, name: str) -> None:
        """To one of those offered."""


@dataclass
class _Plot:
    """Curves over one time axis."""

    title: str
    folder: Any
    bands: Any
    chart: Any = None
    whole: bool = False  # the chart has all curves
    when: deque[float] = field(default_factory=lambda: deque(maxlen=round(SECONDS * RATE)))
    curves: dict[str, deque[float]] = field(default_factory=dict)

    def add(self, signal: str) -> None:
        """A curve more; before now it has no values."""
        self.curves[signal] = deque([float("nan")] * len(self.when), maxlen=self.when.maxlen)
        self.whole = False


class Plots:
    """The tab. Whoever looks may choose; what is drawn is everybody's."""

    def __init__(
        self, server: ViserServer, heard: Heard, refresh: Callable[[], None] | None = None, source: Source | None = None
    ) -> None:
        """Lay it out.

        Args:
            server: of the page.
            heard: what the robot says.
            refresh: called when there is a new curve, whose past may be played again.
            source: of other signals.
        """
        gui = self._gui = server.gui
        self._heard, self._refresh, self._source = heard, refresh, source
        self._wanted: deque[Callable[[], None]] = deque()
        self._plots: list[_Plot] = []
        self._noted, self._drawn, self._made = float("-inf"), 0.0, 0
        self._choice = gui.add_dropdown("signal", ("none heard yet",))
        self._place = gui.add_dropdown("into", (NEW,))
        gui.add_button("Draw it").on_click(self._asked(self._draw_chosen))
        self._joint = gui.add_dropdown("joint", ("none heard yet",))
        gui.add_button("Draw its tracking").on_click(self._asked(self._draw_tracking))
        if source is not None:
            self._other = gui.add_dropdown("topic", ("none heard yet",), hint="whose numbers are to be signals, too")
            gui.add_button("Listen to it").on_click(self._asked(lambda: source.listen(str(self._other.value))))

    def _asked(self, act: Callable[[], None]) -> Callable[[Any], None]:
        """Have the loop do it."""
        return lambda _: self._wanted.append(act)

    def past(self) -> float:
        """How much of the past is shown [s]."""
        return SECONDS if self._plots else 0.0

    def forget(self) -> None:
        """All values; the plots stay."""
        self._noted = float("-inf")
        for plot in self._plots:
            plot.when.clear()
            for values in plot.curves.values():
                values.clear()

    def note(self, now: float, wall: float) -> None:
        """Sample; ``now``: of the ages, ``wall``: of the time axis [s]."""
        if not self._plots or now - self._noted < 0.99 / RATE:
            return
        self._noted = now
        known = self._known()
        for plot in self._plots:
            plot.when.append(wall)
            for signal, values in plot.curves.items():
                values.append(known.get(signal, float("nan")))

    def draw(self, wall: float) -> None:
        """Offer what is heard, and draw."""
        if time.monotonic() - self._drawn < DRAWN:
            return
        self._drawn = time.monotonic()
        if self._heard.joints:
            _offer(self._choice, sorted(self._known()))
            _offer(self._joint, self._heard.joints)
        if self._source is not None:
            _offer(self._other, self._source.offered())
        while self._wanted:
            self._wanted.popleft()()
        for plot in self._plots:
            if not plot.whole:
                self._make_chart(plot)
            if len(plot.when) > 1:
                plot.chart.data = tuple(np.array(values) for values in (plot.when, *plot.curves.values()))
                plot.bands.content = self._heard.modes.markup(plot.when[0], wall)

    def _known(self) -> dict[str, float]:
        known = signals(self._heard)
        if self._source is not None:
            known.update(self._source.values())
        return known

    def _draw_chosen(self) -> None:
        signal, place = str(self._choice.value), str(self._place.value)
        if signal not in self._known():
            return
        plot = next((each for each in self._plots if each.title == place), None)
        if plot is None:
            self._add(signal, (signal,))
        elif signal not in plot.curves:
            plot.add(signal)
            self._changed()

    def _draw_tracking(self) -> None:
        joint = str(self._joint.value)
        if joint in self._heard.joints:
            self._add(f"tracking of {joint}", (position(joint), commanded(joint)))

    def _add(self, name: str, curves: Iterable[str]) -> None:
        self._made += 1
        title = f"{self._made}: {name}"
        with self._gui.add_folder(title) as folder:
            bands = self._gui.add_html("", order=1.0)
            button = self._gui.add_button("Remove", order=2.0)
        plot = _Plot(title, folder, bands)
        for signal in curves:
            plot.add(signal)
        button.on_click(self._asked(lambda: self._remove(plot)))
        self._plots.append(plot)
        self._changed()

    def _remove(self, plot: _Plot) -> None:
        self._plots.remove(plot)
        plot.folder.remove()
        self._changed()

    def _changed(self) -> None:
        _offer(self._place, [NEW, *(plot.title for plot in self._plots)])
        if self._refresh is not None:
            self._refresh()

    def _make_chart(self, plot: _Plot) -> None:
        """Anew where there is another curve: a chart's curves are fixed."""
        styled = [
            uplot.Series(label=signal, stroke=COLORS[place % len(COLORS)], width=1.5)
            for place, signal in enumerate(plot.curves)
        ]
        empty = tuple(np.array([0.0, 1.0]) * (np.nan if place else 1.0) for place in range(len(styled) + 1))
        if plot.chart is not None:
            plot.chart.remove()
        plot.whole = True
        with plot.folder:
            plot.chart = self._gui.add_uplot(empty, (uplot.Series(label="time"), *styled), aspect=2.2, order=0.0)


def _offer(dropdown: Any, options: Iterable[str]) -> None:
    """What has changed; who has chosen keeps the choice."""
    if (now := tuple(options)) and now != tuple(dropdown.options):
        dropdown.options = now
