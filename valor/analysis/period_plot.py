"""The picture of ``valorctl trace``: single periods as lanes, how long periods and their parts are, who is to blame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from valor.analysis import style
from valor.analysis.lanes import Lane
from valor.analysis.period import SLEEP, WITHOUT_CORE, Blame, Periods
from valor.common.trace import IDLE, Stage

_EXAMPLES = ((50.0, "a typical period"), (99.0, "99 % are no longer than this"), (100.0, "the longest"))
_MARGIN = 0.15  # shown before and behind, of the period
_SHOWN = 10  # of the ranking
_BLUE, _ORANGE, _GREEN, _PINK, _YELLOW, _SKY, _BLACK, _BROWN = style.SERIES
_COLLECTS = "#d40000"
_COLORS = {
    Stage.PUBLISH: _BLUE,
    Stage.PHYSICS: _SKY,
    Stage.DEVICES: _SKY,
    Stage.MEASURE: _GREEN,
    Stage.ATTEND: _BROWN,
    Stage.OVERSLEEP: _ORANGE,
    Stage.DECODE: _GREEN,
    Stage.TAKE_COMMANDS: _YELLOW,
    Stage.CONTROL: _PINK,
    Stage.SEND_MOTOR: _BLUE,
    Stage.SEND_STATE: _BLUE,
    Stage.PUBLISH_JOINTS: _BLUE,
    Stage.CONTROLLERS: _PINK,
    Stage.PUBLISH_ROS: _BLUE,
    Stage.DISCOVER: _BROWN,
    Stage.DRAIN_BIFROST: _GREEN,
    Stage.DRAIN_ROS: _YELLOW,
    Stage.WRITE: _BLACK,
}
_LEGEND = (
    ("physics, devices", _SKY), ("measures, decodes, drains Bifrost", _GREEN), ("control, controllers", _PINK),
    ("sends", _BLUE), ("takes commands, drains ROS", _YELLOW), ("statistics, reports, discovery", _BROWN),
    ("writes", _BLACK), ("late: due, not yet awake", _ORANGE), ("collects garbage", _COLLECTS),
)  # fmt: skip


def draw(periods: Periods, ranking: list[Blame], file: Path) -> Path:
    """Draw all of it; returns the file."""
    figure = style.figure(13.0, 11.5)
    above = figure.add_gridspec(3, 1, left=0.135, right=0.985, bottom=0.5, top=0.915, hspace=0.55)
    for row, (percentile, title) in enumerate(_EXAMPLES):
        axes = figure.add_subplot(above[row])
        _draw_lanes(axes, periods, periods.example(percentile), title)
    axes.set_xlabel("time since Proprioceptor was sent [ms]", fontsize=9, color=style.GREY)
    handles = [Patch(color=color, label=label) for label, color in _LEGEND]
    handles.append(Patch(facecolor="white", edgecolor=_PINK, linewidth=2.0, label="hollow: without a core"))
    style.legend(figure, handles, loc="upper center", bbox_to_anchor=(0.55, 0.463), ncols=5)
    _draw_lengths(figure.add_axes((0.065, 0.06, 0.4, 0.315)), periods)
    _draw_ranking(figure.add_axes((0.73, 0.06, 0.255, 0.315)), ranking)
    style.heading(
        figure,
        "One control period through all processes",
        periods.describe(),
    )
    return style.save(figure, file)


def _draw_lanes(axes: Axes, periods: Periods, index: int, title: str) -> None:
    """What every service did in one period."""
    began, length = periods.start[index], periods.length[index]
    first, last = began - _MARGIN * length, began + (1.0 + _MARGIN) * length
    style.quiet(axes, f"{title}: {1e3 * length:.2f} ms")
    names = list(periods.lanes)
    for row, name in enumerate(names):
        _draw_lane(axes, periods.lanes[name], row, _Window(first, last, began))
    for at in (0.0, 1e3 * length):
        axes.axvline(at, color=style.INK, linewidth=0.9)
    axes.axvline(1e3 * periods.nominal, color=style.GREY, linewidth=0.9, linestyle=(0, (4, 2)))
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.45, -0.55)
    axes.set_xlim(1e3 * (first - began), 1e3 * (last - began))


@dataclass(frozen=True)
class _Window:
    """What is shown, and what is zero on its axis [monotonic, s]."""

    first: float
    last: float
    zero: float

    def bar(self, axes: Axes, row: int, span: tuple[float, float], height: float, color: str, **more: Any) -> None:
        """Draw what lies in the window of a span."""
        start, end = max(self.first, span[0]), min(self.last, span[1])
        if end > start:
            axes.barh(row, 1e3 * (end - start), left=1e3 * (start - self.zero), height=height, color=color, **more)


def _draw_lane(axes: Axes, lane: Lane, row: int, window: _Window) -> None:
    first, last = window.first, window.last
    shown = np.flatnonzero((lane.end > first) & (lane.start < last))
    for i in shown:
        stage = Stage(lane.stages[i])
        if stage in IDLE and stage is not Stage.OVERSLEEP:
            continue
        start, end = lane.start[i], lane.end[i]
        window.bar(axes, row, (start, end), 0.62, _COLORS[stage])
        # Of work, what was done without the core is hollow: how much of it, not when.
        idle = end - start - lane.cpu[i]
        if stage is not Stage.OVERSLEEP and idle > 0.05 * (last - first):
            window.bar(axes, row, (start, start + idle), 0.34, "white", alpha=0.75)
    for start, end in lane.collected:
        window.bar(axes, row, (start, end), 0.16, _COLLECTS)


def _draw_lengths(axes: Axes, periods: Periods) -> None:
    """How many are longer than so much: periods, and the segments that are the longest."""
    style.quiet(axes, "how many take longer", "[ms]", "share of the periods")
    segments = [s for s in periods.segments if s.name != SLEEP]
    segments.sort(key=lambda segment: -float(np.percentile(segment.duration, 99)))
    curves = [("period", periods.length, style.INK, 2.0)]
    curves += [(s.title, s.duration, color, 1.2) for s, color in zip(segments, style.SERIES[:5], strict=False)]
    for name, values, color, width in curves:
        ordered = np.sort(values)
        share = 1.0 - np.arange(len(ordered)) / len(ordered)
        axes.step(1e3 * ordered, share, where="post", color=color, linewidth=width, label=name)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(0.02, max(10.0, 1.2e3 * float(periods.length.max())))
    axes.set_ylim(0.5 / len(periods.length), 1.3)
    style.legend(axes, axes.get_legend_handles_labels()[0], loc="lower left")


def _draw_ranking(axes: Axes, ranking: list[Blame]) -> None:
    """Who made the world wait."""
    style.quiet(axes, "who made the world wait", "delay in all periods more than a tenth too long [ms]")
    worst = ranking[:_SHOWN]
    for row, blame in enumerate(worst):
        delay = 1e3 * blame.delay
        axes.barh(row, delay, color=_ORANGE if blame.cause == WITHOUT_CORE else style.GREY, height=0.6)
        axes.text(delay, row, f"  {delay:.1f} ms, {blame.periods} periods", va="center", fontsize=8)
    axes.set_yticks(range(len(worst)), [f"{blame.title}: {blame.cause}" for blame in worst])
    axes.tick_params(axis="y", labelsize=7.5)
    axes.set_ylim(max(len(worst), 1) - 0.4, -0.6)
    axes.set_xlim(right=1.7e3 * max((blame.delay for blame in worst), default=1e-3))
