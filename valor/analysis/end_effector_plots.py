"""The figures of thesis 5.4: a hand's errors over time, on a fixed and a floating base; the robot at its poses."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from valor.analysis import style
from valor.analysis.bands import bands
from valor.analysis.end_effector import HandTrack, PoseError
from valor.analysis.recording import Recording
from valor.analysis.scene import Scene
from valor.common.arrays import FloatArray

_AXES = ("x", "y", "z")
_TURNS = ("roll", "pitch", "yaw")
_PANEL = (420, 560)  # [pixels]
_DPI = 100
_MIDDLE = np.array([0.0, -0.12, 1.12])  # of the pictures, on the ground below the pelvis: room for a right arm [m]


def errors(track: HandTrack, error: PoseError, title: str, subtitle: str, file: Path) -> Path:
    """Position above and orientation below, by component, over time."""
    figure, panels = _two_panels()
    at = track.time - track.time[0]
    for row, (axes, values, names, unit) in enumerate(
        (
            (panels[0], 100.0 * error.position, _AXES, "[cm]"),
            (panels[1], np.rad2deg(error.orientation), _TURNS, "[°]"),
        )
    ):
        last = row == 1
        style.quiet(axes, ("position", "orientation")[row], "robot time [s]" if last else "", unit)
        for i, name in enumerate(names):
            axes.plot(at, values[:, i], color=style.SERIES[i], linewidth=1.3, label=name)
        if row == 0:
            axes.plot(at, np.linalg.norm(values, axis=1), color=style.GREY, linewidth=0.9, label="distance")
        _finish(axes, at, np.array([values.min(), np.linalg.norm(values, axis=1).max() if row == 0 else values.max()]))
        _name(axes, at, track, columns=4)
    style.heading(figure, title, subtitle)
    return style.save(figure, file)


def base(track: HandTrack, file: Path) -> Path:
    """What the base's motion does to the hand, by component and as a distance, beside the whole error."""
    figure, (above, below) = _two_panels()
    at = track.time - track.time[0]
    moved, total = track.base_error, track.total_error
    style.quiet(above, "floating base minus fixed base", "", "[cm]")
    for i, name in enumerate(_AXES):
        above.plot(at, 100.0 * moved.position[:, i], color=style.SERIES[i], linewidth=1.3, label=name)
    _distances(below, at, track)
    top = 130.0 * float(max(moved.distance.max(), np.quantile(total.distance, 0.3)))
    below.set_ylim(0.0, max(top, 1.0))  # on the way to a goal the whole error is far larger: not what this is about
    _finish(above, at, 100.0 * moved.position)
    below.set_xlim(at[0], at[-1])
    for axes in (above, below):
        _name(axes, at, track)
    largest = 100.0 * float(moved.distance.max())
    style.heading(figure, "What the floating base does to the hand", f"at most {largest:.1f} cm")
    return style.save(figure, file)


def shares(track: HandTrack, file: Path) -> Path:
    """The whole error from the goal and the floating base's part of it, by component and as distances (figure 5.15)."""
    figure, (above, below) = _two_panels()
    at = track.time - track.time[0]
    total, moved = track.total_error, track.base_error
    style.quiet(above, "solid: from the goal; dashed: by the floating base", "", "[cm]")
    for i, name in enumerate(_AXES):
        above.plot(at, 100.0 * total.position[:, i], color=style.SERIES[i], linewidth=1.3, label=name)
        above.plot(at, 100.0 * moved.position[:, i], color=style.SERIES[i], linewidth=1.1, linestyle=(0, (3, 2)))
    _distances(below, at, track)
    # On the way to a goal errors are those of motions that are not made yet: what stays is what is looked at.
    rest = np.concatenate([np.flatnonzero(track.settled(motion)) for motion in track.motions])
    most = 140.0 * float(np.abs(total.position[rest]).max())
    above.set_ylim(-max(most, 1.0), max(most, 1.0))
    below.set_ylim(0.0, max(140.0 * float(total.distance[rest].max()), 1.0))
    for axes in (above, below):
        axes.set_xlim(at[0], at[-1])
        _name(axes, at, track)
    largest = 100.0 * float(total.distance[rest].max())
    style.heading(figure, "Whose error it is", f"at rest at most {largest:.1f} cm from the goal")
    return style.save(figure, file)


def torso(track: HandTrack, file: Path) -> Path:
    """How the chest, which carries the arms, moves while an arm does."""
    figure = style.figure(11.0, 3.4)
    axes = figure.add_axes((0.07, 0.15, 0.915, 0.60))
    at = track.time - track.time[0]
    moved = 100.0 * (track.chest.position - track.chest.position[0])
    style.quiet(axes, "", "robot time [s]", "[cm]")
    for i, name in enumerate(_AXES):
        axes.plot(at, moved[:, i], color=style.SERIES[i], linewidth=1.4, label=name)
    _finish(axes, at, moved)
    _name(axes, at, track, top=1.28)
    style.heading(figure, "The torso gives way to the arm", "position of the chest from where it was")
    return style.save(figure, file)


def poses(recording: Recording, track: HandTrack, names: Sequence[str], file: Path) -> Path:
    """The robot at rest at some poses, drawn, with how far hand and torso are from where they were meant to be."""
    motions = {motion.name: motion for motion in track.motions}
    chosen = [motions[name] for name in names if name in motions]
    width, height = _PANEL
    with closing(Scene(recording.robot, width, height, *recording.world)) as scene:
        images = []
        for motion in chosen:
            posture = recording.posture(motion.end)
            scene.look_at(posture.pelvis_position * (1.0, 1.0, 0.0) + _MIDDLE, distance=3.1, azimuth=140.0)
            images.append(scene.draw(posture))
    header = 84
    figure = style.figure(len(chosen) * width / _DPI, (height + header) / _DPI, _DPI)
    share = height / (height + header)
    for i, (motion, image) in enumerate(zip(chosen, images, strict=True)):
        figure.figimage(image, xo=i * width, yo=0, origin="upper")
        rest = track.settled(motion)
        moved = 100.0 * float(track.base_error.distance[rest].mean())
        off = 100.0 * float(track.total_error.distance[rest].mean())
        middle, top = (i + 0.5) / len(chosen), share + (1.0 - share) * 0.66
        figure.text(middle, top, motion.name, ha="center", va="center", fontsize=15, color=style.INK, weight="bold")
        text = f"hand off by {off:.1f} cm; the torso gave way by {moved:.1f} cm"
        figure.text(middle, top - (1.0 - share) * 0.36, text, ha="center", va="center", fontsize=9.5, color=style.GREY)
    return style.save(figure, file, _DPI)


def _two_panels() -> tuple[Figure, tuple[Axes, Axes]]:
    """A figure, and its axes: above, below."""
    figure = style.figure(11.0, 5.8)
    grid = figure.add_gridspec(2, 1, left=0.07, right=0.985, bottom=0.09, top=0.80, hspace=0.42)
    return figure, (figure.add_subplot(grid[0]), figure.add_subplot(grid[1]))


def _distances(axes: Axes, at: FloatArray, track: HandTrack) -> None:
    style.quiet(axes, "distance", "robot time [s]", "[cm]")
    for error, color, width, label in (
        (track.total_error, style.GREY, 1.3, "from the goal, all causes"),
        (track.base_error, style.MEASURED, 1.6, "by the base's motion"),
    ):
        axes.plot(at, 100.0 * error.distance, color=color, linewidth=width, label=label)


def _finish(axes: Axes, at: FloatArray, values: FloatArray) -> None:
    axes.set_xlim(at[0], at[-1])
    low, high = float(values.min()), float(values.max())
    room = max(high - low, 1e-3)
    axes.set_ylim(low - 0.18 * room, high + 0.12 * room)  # below: the bands


def _name(axes: Axes, at: FloatArray, track: HandTrack, columns: int = 3, top: float = 1.24) -> None:
    """The behaviors below, a thin line where each motion begins, and the legend above."""
    bands(axes, at, track.behavior)
    for motion in track.motions:
        axes.axvline(motion.start - track.time[0], color=style.LIGHT, linewidth=0.9, zorder=0.6)
    style.legend_above(axes, columns, top)
