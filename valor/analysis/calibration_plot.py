"""What the torques of an arm's joints leave unexplained, over their velocity: by nominal numbers, and as calibrated."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from valor.analysis import style
from valor.common.arrays import FloatArray

COLUMNS = 4
MOST = 1500  # points of a joint


@dataclass(frozen=True)
class Panel:
    """A joint: velocity [rad/s], and torque that is left by nominal numbers and as calibrated [N·m]; (T,) each."""

    joint: str
    velocity: FloatArray
    nominal: FloatArray
    calibrated: FloatArray


def draw(panels: Sequence[Panel], file: Path, told: str) -> Path:
    """Write the picture.

    Args:
        panels: of the joints.
        file: of a kind that matplotlib knows by its ending.
        told: one line about it.

    Raises:
        OSError: it cannot be written.
        ValueError: matplotlib knows no such kind.
    """
    rows = math.ceil(len(panels) / COLUMNS)
    height = 1.0 + 2.2 * rows
    made = style.figure(12.0, height)
    style.heading(made, "Torque that the model does not explain", told)
    grid = made.subplots(
        rows,
        COLUMNS,
        squeeze=False,
        gridspec_kw={
            "left": 0.05, "right": 0.985, "top": 1.0 - 0.95 / height, "bottom": 0.5 / height,
            "hspace": 0.5, "wspace": 0.25,
        },
    )  # fmt: skip
    for axes in grid.flat[len(panels) :]:
        axes.set_visible(False)
    for place, (axes, panel) in enumerate(zip(grid.flat, panels, strict=False)):
        last = place + COLUMNS >= len(panels)
        style.quiet(axes, panel.joint, "velocity [rad/s]" if last else "", "" if place % COLUMNS else "[N·m]")
        step = max(1, panel.velocity.size // MOST)
        for left, color in ((panel.nominal, style.GREY), (panel.calibrated, style.MEASURED)):
            axes.plot(panel.velocity[::step], left[::step], ".", color=color, markersize=2.0, alpha=0.5)
        most = max(1.0, *(float(np.abs(left).max(initial=0.0)) for left in (panel.nominal, panel.calibrated)))
        axes.set_ylim(-1.1 * most, 1.1 * most)
    names = [style.sample("nominal", style.GREY, 3.0), style.sample("calibrated", style.MEASURED, 3.0)]
    style.legend(made, names, loc="upper right", ncols=2)
    return style.save(made, file)
