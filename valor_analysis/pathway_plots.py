"""Figures 5.2 and 5.3 of the thesis: latencies segment by segment, and their sums."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from matplotlib.lines import Line2D

from valor_analysis import style
from valor_analysis.pathways import Latencies

_COLORS = {"VRC": "#0072b2", "Motion System": "#d55e00", "robot": "#009e73"}


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
    for i, latencies in enumerate(found.values()):
        offset = (i - 0.5 * (len(found) - 1)) * width
        for place, segment in enumerate(latencies.segments):
            if not len(segment.samples):
                continue
            at, mean, deviation = place + offset, 1e3 * segment.mean, 1e3 * segment.deviation
            axes.bar(at, mean, 0.92 * width, color=_COLORS[segment.where], alpha=1.0 if i == len(found) - 1 else 0.45)
            axes.errorbar(at, mean, deviation, color=style.INK, linewidth=1.0, capsize=2.5)
            axes.plot(at, 1e3 * segment.median, "D", color="white", markeredgecolor=style.INK, markersize=4.0, zorder=3)
            axes.annotate(f"{mean:.1f}", (at, mean + deviation), (0, 3), textcoords="offset points", ha="center",
                          fontsize=8, color=style.GREY)  # fmt: skip
            bottom, top = min(bottom, mean - deviation if mean < 0.0 else 0.0), max(top, mean + deviation)
    names = [
        segment.name.replace(" → ", " →\n").replace(" change ", "\nchange ")
        for segment in next(iter(found.values())).segments
    ]
    axes.set_xticks(range(len(names)), names)
    axes.tick_params(axis="x", labelcolor=style.INK)
    axes.grid(False, axis="x")
    axes.set_ylim(1.15 * bottom, 1.15 * top)
    axes.axhline(0.0, color=style.GREY, linewidth=0.8)
    handles = [Line2D([], [], color=color, linewidth=6.0, label=name) for name, color in _COLORS.items()]
    if len(found) > 1:
        shades = zip(found, (0.45, 1.0), strict=True)
        handles += [Line2D([], [], color=style.GREY, alpha=a, linewidth=6.0, label=name) for name, a in shades]
    style.legend(figure, handles, loc="upper right", bbox_to_anchor=(0.99, 0.97), ncols=len(handles))
    style.heading(
        figure,
        "How long each step takes",
        "from one message sent to the next: means; lines: one standard deviation; diamonds: medians",
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
    lowest = highest = 0.0
    for group, pathways in enumerate(zip(*(latencies.pathways for latencies in found.values()), strict=True)):
        for i, (profile, pathway) in enumerate(zip(found, pathways, strict=True)):
            at = -(group * (len(found) + 0.4) + i)
            ends = {True: 0.0, False: 0.0}  # what is below zero stands to the left of it
            for segment in pathway.segments:
                color = used.setdefault(segment.name, style.SERIES[names.index(segment.name)])
                step = 1e3 * segment.mean
                axes.barh(at, step, 0.8, left=ends[step >= 0.0], color=color)
                ends[step >= 0.0] += step
            total, deviation = 1e3 * pathway.mean, 1e3 * pathway.deviation
            axes.errorbar(total, at, xerr=deviation, color=style.GREY, linewidth=1.0, capsize=3)
            lowest, end = min(lowest, ends[False]), max(ends[True], total + deviation)
            highest = max(highest, end)
            text = f"{total:.1f} ms (thesis: {thesis[pathway.name]})"
            axes.annotate(
                text, (end, at), (6, 0), textcoords="offset points", va="center", fontsize=8.5, color=style.GREY
            )
            labels.append((at, f"{pathway.name}, {profile}"))
    axes.set_yticks([at for at, _ in labels], [label for _, label in labels])
    axes.tick_params(axis="y", labelcolor=style.INK)
    axes.grid(False, axis="y")
    axes.set_xlim(1.1 * lowest, 1.3 * highest)
    axes.axvline(0.0, color=style.GREY, linewidth=0.8)
    handles = [Line2D([], [], color=color, linewidth=6.0, label=name) for name, color in used.items()]
    style.legend(figure, handles, loc="lower left", bbox_to_anchor=(0.01, 0.0), ncols=4)
    style.heading(figure, "From end to end", "the segments of each pathway; lines: one standard deviation of the sum")
    return style.save(figure, file)
