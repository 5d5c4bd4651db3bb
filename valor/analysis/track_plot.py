"""A walk in one picture, from what an observer heard of it: its way, the DCM's error, the feet's forces, the knees."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from valor.analysis import style
from valor.analysis.walk import Track


def draw(track: Track, file: Path, told: str) -> Path:
    """Write the picture.

    Args:
        track: of the walk.
        file: of a kind that matplotlib knows by its ending.
        told: one line about it.

    Returns:
        The file.

    Raises:
        OSError: it cannot be written.
        ValueError: matplotlib knows no such kind.
    """
    made = style.figure(10.0, 8.0)
    style.heading(made, "A walk, as the robot believes", told)
    way, error, force, knee = made.subplots(
        4, 1, gridspec_kw={"left": 0.08, "right": 0.97, "top": 0.89, "bottom": 0.07, "hspace": 0.55}
    )
    time = track.time - track.time[0]
    style.quiet(way, "pelvis from above, from where it began", "x in odom [m]", "y [m]")
    path = track.pelvis - track.pelvis[0]
    style.curve(way, path[:, 0], path[:, 1], style.INK, 1.3)
    way.set_aspect("equal", adjustable="datalim")
    style.quiet(error, "DCM from its reference", "", "[mm]")
    style.curve(error, time, 1e3 * np.linalg.norm(track.dcm_error[:, :2], axis=1), style.INK, 1.0)
    style.quiet(force, "vertical foot force: measured, and planned (dashed)", "", "[N]")
    style.quiet(knee, "knee angle", "robot time [s]", "[rad]")
    for side, colour in ((0, style.LEFT), (1, style.RIGHT)):
        style.curve(force, time, track.measured_force[:, side], colour, 1.0)
        style.curve(force, time, track.desired_force[:, side], colour, 0.8, linestyle=(0, (3, 2)))
        style.curve(knee, time, track.knee[:, side], colour, 1.0)
    names = [style.sample("left", style.LEFT, 1.5), style.sample("right", style.RIGHT, 1.5)]
    style.legend(made, names, loc="upper right", ncols=2)
    return style.save(made, file)
