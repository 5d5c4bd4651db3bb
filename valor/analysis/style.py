"""Style of all plots: one palette and one layout, no global state.

Colors are Okabe and Ito's, distinguishable with color blindness: references are ink, set-points green, commands blue,
measurements vermilion; left is blue, right vermilion; x, y, z are the first three of ``SERIES``. Dashed
lines are planned or estimated values.
"""

from pathlib import Path
from typing import Any

from matplotlib import font_manager
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from valor.common.arrays import FloatArray
from valor.drawing import marks

INK, GREY, LIGHT = "#22272e", "#6b7480", "#dde1e6"
REFERENCE, SETPOINT, COMMAND, MEASURED = "#22272e", "#009e73", "#0072b2", "#d55e00"
LEFT, RIGHT = marks.LEFT, marks.RIGHT  # of feet, soles and knees
SERIES = (LEFT, RIGHT, "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#22272e", "#8c6d46")
GROUND = LinearSegmentedColormap.from_list("ground", ("#6e5238", "#b59a7c", "#f3ece2"))  # low to high
DASHES = (0, (2, 2))  # planned or estimated
FONT = "DejaVu Sans"
POINTS = 4000  # maximum number drawn of a curve


def figure(width: float, height: float, dpi: float = 110) -> Figure:
    """Make an empty figure [inches] that needs no display."""
    made = Figure(figsize=(width, height), dpi=dpi, facecolor="white")
    FigureCanvasAgg(made)
    return made


def quiet(axes: Axes, title: str = "", x_label: str = "", y_label: str = "") -> None:
    """Set labels and remove decoration of some axes."""
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
    """Make a line in the figure's coordinates, 0 to 1, for ``add_artist``."""
    return Line2D(x, y, color=color, linewidth=width)


def curve(axes: Axes, x: FloatArray, y: FloatArray, color: str, width: float, **more: Any) -> None:
    """Draw a line through many points, decimated to at most ``POINTS``."""
    step = max(1, len(x) // POINTS)
    axes.plot(x[::step], y[::step], color=color, linewidth=width, solid_capstyle="round", **more)


def heading(figure: Figure, title: str, subtitle: str) -> None:
    """Write title and subtitle, top left."""
    height = figure.get_figheight()
    figure.text(0.012, 1.0 - 0.16 / height, title, fontsize=14, weight="bold", color=INK, va="top")
    figure.text(0.012, 1.0 - 0.47 / height, subtitle, fontsize=9.5, color=GREY, va="top")


def legend(target: Any, handles: list[Any], **where: Any) -> None:
    """Add a legend without a box."""
    made = target.legend(handles=handles, frameon=False, fontsize=9, labelcolor=INK, **where)
    for text in made.get_texts():
        text.set_fontproperties(font_manager.FontProperties(family=FONT, size=9))


def sample(label: str, color: str, width: float, **more: Any) -> Line2D:
    """Make a line of a legend."""
    return Line2D([], [], color=color, linewidth=width, label=label, **more)


def save(figure: Figure, path: Path, dpi: float = 110) -> Path:
    """Write a PNG; returns its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=dpi)
    return path
