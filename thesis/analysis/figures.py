"""Legends and bands of this package's plots."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from valor.analysis import bands, style


def keys(behaviors: Iterable[str]) -> list[Patch]:
    """Legend of bands without labels: one patch per behavior, in order of first appearance."""
    return [Patch(color=bands.color(name), label=name.replace("_", " ")) for name in dict.fromkeys(map(str, behaviors))]


def make_room(axes: Axes) -> None:
    """Extend a plot downwards, so that bands lie below its values."""
    low, high = axes.get_ylim()
    axes.set_ylim(low - 1.4 * bands.HEIGHT * (high - low), high)
    axes.set_yticks([tick for tick in axes.get_yticks() if low <= tick <= high])


def key(figure: Figure, handles: list[Any], left: float = 0.005) -> None:
    """Add a legend in a separate row below a figure's heading."""
    top = 1.0 - 0.66 / figure.get_figheight()
    style.legend(figure, handles, loc="upper left", bbox_to_anchor=(left, top), ncols=len(handles))


def legend_above(axes: Axes, columns: int, top: float) -> None:
    """Add a legend of the labelled curves above the right end of a plot; ``top`` in the axes' heights."""
    handles = axes.get_legend_handles_labels()[0]
    style.legend(axes, handles, loc="upper right", bbox_to_anchor=(1.0, top), ncols=columns)
