"""Figures 5.2 and 5.3 of the thesis: latencies segment by segment, their sums, and all of them over time.

Under each bar stands the behavior of the Motion System in which most of its samples began.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from thesis.analysis.figures import keys, make_room
from thesis.analysis.pathways import JOINT_COMMAND, Latencies, Pathway, Segment
from valor.analysis import style
from valor.analysis.bands import bands, color

_COLORS = dict(zip(("VRC", "Motion System", "robot"), style.SERIES, strict=False))


def bars(found: Mapping[str, Latencies], file: Path) -> Path:
    """Figure 5.2: a bar a segment and profile, colored by the system that takes the time.

    Args:
        found: latencies by the plant's profile, one or two.
        file: of the picture.
    """
    figure = style.figure(11.0, 4.8)
    axes = figure.add_axes((0.065, 0.2, 0.92, 0.6))
    style.quiet(axes, "", "", "latency [ms]")
    width = 0.8 / len(found)
    bottom = top = 0.0
    under: list[tuple[float, str]] = []
    for i, latencies in enumerate(found.values()):
        offset = (i - 0.5 * (len(found) - 1)) * width
        for place, segment in enumerate(latencies.segments):
            if not len(segment.by_stamps):
                continue
            at, mean = place + offset, 1e3 * segment.mean
            low, high = _ends(segment)
            axes.bar(at, mean, 0.92 * width, color=_COLORS[segment.where], alpha=1.0 if i == len(found) - 1 else 0.45)
            axes.errorbar(at, low, [[0.0], [high - low]], fmt="none", ecolor=style.INK, elinewidth=1.0, capsize=2.5)
            axes.plot(at, 1e3 * segment.median, "D", color="white", markeredgecolor=style.INK, markersize=4.0, zorder=3)
            axes.annotate(f"{mean:.1f}", (at, max(mean, high)), (0, 3), textcoords="offset points", ha="center",
                          fontsize=8, color=style.GREY)  # fmt: skip
            under.append((at, _behavior(latencies, segment)))
            top = max(top, mean, high)
            if len(segment.by_correlation):
                shift = 1e3 * float(segment.by_correlation.mean())
                axes.plot(at, shift, "x", color=style.INK, markersize=6.0, zorder=3)
                bottom, top = min(bottom, 1.3 * shift), max(top, shift)
    names = [
        segment.name.replace(" → ", " →\n").replace(" change ", "\nchange ")
        for segment in next(iter(found.values())).segments
    ]
    axes.set_xticks(range(len(names)), names)
    axes.tick_params(axis="x", labelcolor=style.INK)
    axes.grid(False, axis="x")
    foot = bottom - 0.07 * (top - bottom)
    axes.set_ylim(foot, 1.15 * top)
    for at, behavior in under:
        axes.bar(at, 0.05 * (top - bottom), width, bottom=foot, color=color(behavior), zorder=0.5)
    axes.axhline(0.0, color=style.GREY, linewidth=0.8)
    handles = [style.sample(name, color, 6.0) for name, color in _COLORS.items()]
    if len(found) > 1:
        shades = zip(found, (0.45, 1.0), strict=True)
        handles += [style.sample(name, style.GREY, 6.0, alpha=a) for name, a in shades]
    style.legend(figure, handles, loc="upper right", bbox_to_anchor=(0.99, 0.97), ncols=len(handles))
    named = keys(behavior for _, behavior in under)
    style.legend(figure, named, loc="lower right", bbox_to_anchor=(0.99, 0.0), ncols=len(named))
    style.heading(
        figure,
        "How long each step takes",
        "from one message sent to the next: means; lines: 5th to 95th percentile; diamonds: medians; "
        "crosses: by correlation",
    )
    return style.save(figure, file)


def sums(found: Mapping[str, Latencies], thesis: Mapping[str, str], file: Path) -> Path:
    """Figure 5.3: the segments of each pathway, stacked.

    Args:
        found: latencies by the plant's profile, one or two.
        thesis: the sums in the thesis [ms], by pathway.
        file: of the picture.
    """
    count = len(found) * len(thesis)
    figure = style.figure(11.0, 2.1 + 0.5 * count)
    height = figure.get_figheight()
    axes = figure.add_axes((0.19, 0.95 / height, 0.795, 1.0 - 2.1 / height))
    style.quiet(axes, "", "latency [ms]")
    names = [segment.name for segment in next(iter(found.values())).segments]
    used: dict[str, str] = {}
    labels = []
    highest = 0.0
    under: list[str] = []
    for group, pathways in enumerate(zip(*(latencies.pathways for latencies in found.values()), strict=True)):
        for i, ((profile, latencies), pathway) in enumerate(zip(found.items(), pathways, strict=True)):
            at = -(group * (len(found) + 0.4) + i)
            end = 0.0
            for segment in pathway.segments:
                shade = used.setdefault(segment.name, style.SERIES[names.index(segment.name)])
                step = 1e3 * segment.mean
                axes.barh(at, step, 0.68, left=end, color=shade)
                if len(segment.by_stamps):
                    under.append(_behavior(latencies, segment))
                    axes.barh(at - 0.42, step, 0.12, left=end, color=color(under[-1]))
                end += step
            total, (low, high) = 1e3 * pathway.mean, _ends(pathway)
            axes.errorbar(low, at, xerr=[[0.0], [high - low]], fmt="none", ecolor=style.INK, elinewidth=1.0, capsize=3)
            end = float(np.nanmax((end, total, high)))
            highest = max(highest, end)
            by = f"by correlation {1e3 * pathway.behind:.1f}, " if pathway.name == JOINT_COMMAND else ""
            text = f"{total:.1f} ms ({by}thesis: {thesis[pathway.name]})"
            axes.annotate(
                text, (end, at), (6, 0), textcoords="offset points", va="center", fontsize=8.5, color=style.GREY
            )
            labels.append((at, f"{pathway.name}, {profile}"))
    axes.set_yticks([at for at, _ in labels], [label for _, label in labels])
    axes.tick_params(axis="y", labelcolor=style.INK)
    axes.grid(False, axis="y")
    axes.set_xlim(0.0, 1.45 * highest)
    handles = [style.sample(name, shade, 6.0) for name, shade in used.items()]
    style.legend(figure, handles, loc="lower left", bbox_to_anchor=(0.01, 0.0), ncols=4)
    style.legend(figure, keys(under), loc="lower right", bbox_to_anchor=(0.99, 0.0), ncols=1)
    style.heading(figure, "From end to end", "the segments' means, by stamps; lines: 5th to 95th percentile of the sum")
    return style.save(figure, file)


def over_time(found: Mapping[str, Latencies], file: Path) -> Path:
    """Every latency when it was met: a row a pathway, a column a profile, and what the Motion System did meanwhile.

    Args:
        found: latencies by the plant's profile, one or two.
        file: of the picture.
    """
    names = [segment.name for segment in next(iter(found.values())).segments]
    rows = len(next(iter(found.values())).pathways)
    height = 1.9 + 1.9 * rows
    figure = style.figure(11.0, height)
    grid = figure.add_gridspec(rows, len(found), left=0.065, right=0.985, bottom=1.15 / height,
                               top=1.0 - 1.0 / height, hspace=0.5, wspace=0.14)  # fmt: skip
    shown: list[str] = []
    for column, (profile, latencies) in enumerate(found.items()):
        start = float(latencies.time[0])
        for row, pathway in enumerate(latencies.pathways):
            axes = figure.add_subplot(grid[row, column])
            last = row == rows - 1
            style.quiet(axes, f"{pathway.name}, {profile}", "time [s]" if last else "", "[ms]" if column == 0 else "")
            top = 0.0
            for segment in pathway.segments:
                if not len(segment.by_stamps):
                    continue
                shown.append(segment.name)
                thin = max(1, len(segment.by_stamps) // 3000)
                at, value = segment.at[::thin] - start, 1e3 * segment.by_stamps[::thin]
                axes.plot(at, value, ".", color=style.SERIES[names.index(segment.name)], markersize=3.0, alpha=0.6)
                top = max(top, 1.3 * float(np.quantile(value, 0.98)))
            axes.set_xlim(0.0, max(float(latencies.time[-1]) - start, 1e-3))
            axes.set_ylim(0.0, max(top, 1.0))
            make_room(axes)
            bands(axes, latencies.time - start, latencies.behavior, label=False)
    handles = [style.sample(name, style.SERIES[names.index(name)], 0.0, marker=".") for name in dict.fromkeys(shown)]
    style.legend(figure, handles, loc="lower left", bbox_to_anchor=(0.01, 0.0), ncols=4)
    seen = keys(name for latencies in found.values() for name in dict.fromkeys(latencies.behavior))
    style.legend(figure, seen, loc="lower right", bbox_to_anchor=(0.99, 0.0), ncols=1)
    style.heading(figure, "When they were met", "a point a latency; the highest of a hundred are cut off")
    return style.save(figure, file)


def _ends(latency: Segment | Pathway) -> tuple[float, float]:
    """5th and 95th percentile [ms]."""
    low, high = latency.interval
    return 1e3 * low, 1e3 * high


def _behavior(latencies: Latencies, segment: Segment) -> str:
    """In which most samples of a segment began."""
    names, counts = np.unique(latencies.behaviors(segment), return_counts=True)
    return str(names[counts.argmax()])
