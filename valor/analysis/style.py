"""How our figures look: one palette and one grammar for all, no global state.

Colors mean the same everywhere, and are Okabe and Ito's, which everybody can tell apart: what is wanted is ink, what a
client or the VRC asks for green, what is commanded blue, what is measured vermilion; left is blue, right vermilion;
x, y, z are the first three of ``SERIES``. Dashes are what was planned or believed. The title says what is seen, the
line below it the result; the legend has a row of its own, never over either. Every axis has its unit; centimetres are
not drawn on a scale of metres. Bands below a plot are behaviors (``bands.py``); ground has colors of earth
(``GROUND``), never of water. Seen from above, x is to the right, and arrows say where something heads.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib import font_manager
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from valor.common import colors
from valor.common.arrays import FloatArray

INK, GREY, LIGHT = "#22272e", "#6b7480", "#dde1e6"
REFERENCE, SETPOINT, COMMAND, MEASURED = "#22272e", "#009e73", "#0072b2", "#d55e00"
LEFT, RIGHT = colors.LEFT, colors.RIGHT  # of feet, soles and knees
SERIES = (LEFT, RIGHT, "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#22272e", "#8c6d46")
GROUND = LinearSegmentedColormap.from_list("ground", ("#6e5238", "#b59a7c", "#f3ece2"))  # low to high
DASHES = (0, (2, 2))  # of what was planned or believed
FONT = "DejaVu Sans"
POINTS = 4000  # drawn of a curve


def figure(width: float, height: float, dpi: float = 110) -> Figure:
    """An empty figure [inches] that draws without a display."""
    made = Figure(figsize=(width, height), dpi=dpi, facecolor="white")
    FigureCanvasAgg(made)
    return made


def quiet(axes: Axes, title: str = "", x_label: str = "", y_label: str = "") -> None:
    """Axes with nothing on them that says nothing."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(LIGHT)
    axes.tick_params(colors=GREY, labelsize=8.5, length=3)
    axes.grid(True, color=LIGHT, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.set_title(title, fontsize=10, color=INK, loc="left")
    axes.set_xlabel(x_label, fontsize=9, color=GREY)
    axes.set_ylabel(y_label, fontsize=9, color=GREY)


def line(x: tuple[float, float], y: tuple[float, float], color: str, width: float) -> Line2D:
    """A line in the figure's own coordinates, 0 to 1; add it with ``add_artist``."""
    return Line2D(x, y, color=color, linewidth=width)


def curve(axes: Axes, x: FloatArray, y: FloatArray, color: str, width: float, **more: Any) -> None:
    """A line through many points, of which hardly more are drawn than there are pixels."""
    step = max(1, len(x) // POINTS)
    axes.plot(x[::step], y[::step], color=color, linewidth=width, solid_capstyle="round", **more)


def heading(figure: Figure, title: str, subtitle: str) -> None:
    """A figure's title and what it is of, top left."""
    height = figure.get_figheight()
    figure.text(0.012, 1.0 - 0.16 / height, title, fontsize=14, weight="bold", color=INK, va="top")
    figure.text(0.012, 1.0 - 0.47 / height, subtitle, fontsize=9.5, color=GREY, va="top")


def legend(target: Any, handles: list[Any], **where: Any) -> None:
    """A legend without a box."""
    made = target.legend(handles=handles, frameon=False, fontsize=9, labelcolor=INK, **where)
    for text in made.get_texts():
        text.set_fontproperties(font_manager.FontProperties(family=FONT, size=9))


def key(figure: Figure, handles: list[Any], left: float = 0.005) -> None:
    """A legend in a row of its own below a figure's heading."""
    top = 1.0 - 0.66 / figure.get_figheight()
    legend(figure, handles, loc="upper left", bbox_to_anchor=(left, top), ncols=len(handles))


def legend_above(axes: Axes, columns: int, top: float) -> None:
    """A legend of the curves that have names, above the right end of a plot; ``top`` in the axes' heights."""
    handles = axes.get_legend_handles_labels()[0]
    legend(axes, handles, loc="upper right", bbox_to_anchor=(1.0, top), ncols=columns)


def sample(label: str, color: str, width: float, **more: Any) -> Line2D:
    """A line of a legend."""
    return Line2D([], [], color=color, linewidth=width, label=label, **more)


def save(figure: Figure, path: Path, dpi: float = 110) -> Path:
    """Write a PNG; returns its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=dpi)
    return path
