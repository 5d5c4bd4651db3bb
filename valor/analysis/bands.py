"""Behaviors as colored bands below a plot."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from valor.analysis.reading.recording import Recording
from valor.common.arrays import FloatArray
from valor.common.behaviors import Behavior, Locomotion
from valor.common.topics import MOTION_STATE

HEIGHT = 0.05  # of the axes
_OTHER = "#dde1e6"
_L = Locomotion
COLORS: Mapping[Locomotion, tuple[str, str]] = {
    _L.IDLE: ("#c9ced6", _OTHER), _L.STAND_PREP: ("#e3d5a8", _OTHER), _L.STAND: ("#b7d3ea", "#bfe3cf"),
    _L.WALK: ("#f1c8a5", "#f4dd9a"), _L.STEP: ("#e8bfd4", "#d9c3ec"), _L.SOFT_STOP: ("#e6a5a0", _OTHER),
    _L.FREEZE: ("#d98c86", _OTHER), _L.FALL: ("#b55a52", _OTHER),
}  # fmt: skip
"""Colors by locomotion: arms under control of the Motion System, arms following set-points. Others are grey."""
_BEHAVIORS = {
    str(behavior): COLORS.get(behavior.locomotion, (_OTHER, _OTHER))[behavior.manipulating] for behavior in Behavior
}


def color(behavior: str) -> str:
    """Color of a behavior's band."""
    return _BEHAVIORS.get(behavior, _OTHER)


def bands_of(axes: Axes, recording: Recording, start: float, end: float, label: bool = True) -> None:
    """Draw a recording's bands below a plot from ``start`` to ``end``, robot time [s]; its time axis starts at 0."""
    states = recording.series(MOTION_STATE)
    shown = np.flatnonzero((states.time >= start) & (states.time <= end))
    if shown.size:
        bands(axes, states.time[shown] - start, states.strings("behavior")[shown], label)


def bands(axes: Axes, time: FloatArray, behavior: npt.NDArray[np.str_], label: bool = True) -> None:
    """Draw bands of (m,) behaviors at (m,) times along the bottom of a plot; ``label``: write each where it fits."""
    if not len(time):
        return
    edges = np.flatnonzero(behavior[1:] != behavior[:-1]) + 1
    starts = np.concatenate(([0], edges))
    ends = np.concatenate((edges, [len(time) - 1]))
    whole = float(time[-1] - time[0]) or 1.0
    for start, end in zip(starts, ends, strict=True):
        name = str(behavior[start])
        begin, stop = float(time[start]), float(time[end])
        axes.axvspan(begin, stop, ymin=0.0, ymax=HEIGHT, color=color(name), linewidth=0.0, zorder=0.5)
        if label and (stop - begin) / whole > 0.012 * len(name):
            axes.text(
                0.5 * (begin + stop), 0.5 * HEIGHT, name.replace("_", " "), fontsize=7, color="#4a525c",
                ha="center", va="center", transform=axes.get_xaxis_transform(),
            )  # fmt: skip
