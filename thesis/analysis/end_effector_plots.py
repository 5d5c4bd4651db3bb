"""The figures of thesis 5.4: a hand's errors over time, on a fixed and a floating base; the robot at its poses."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thesis.analysis.end_effector import HandTrack, PoseError
from thesis.analysis.figures import key, keys, legend_above, make_room
from thesis.analysis.timeline import Motion
from valor.analysis import style
from valor.analysis.bands import bands
from valor.analysis.reading.recording import Recording
from valor.common.arrays import FloatArray
from valor.drawing import Posture, marks
from valor.drawing.scene import Scene

_AXES = ("x", "y", "z")
_TURNS = ("roll", "pitch", "yaw")
_PANEL = (420, 560)  # [pixels]
_DPI = 100
_GHOST, _THIN = 0.35, 5  # how much of what was wanted is seen; one point of so many of the hand's way is drawn
_FAR = 15.0  # values beyond which the small ones could not be seen any more [cm, °]
_MIDDLE = np.array([0.0, -0.12, 1.12])  # of the pictures, on the ground below the pelvis: room for a right arm [m]


def errors(track: HandTrack, error: PoseError, title: str, subtitle: str, file: Path) -> tuple[Path, str]:
    """Position above and orientation below, by component, over time; returns also what the axes are, as text."""
    logarithmic = []
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
        if _show_small(axes, values):
            logarithmic.append(f"beyond ±1 {unit.strip('[]')}")
        _name(axes, at, track, columns=4)
    style.heading(figure, title, subtitle)
    axes_are = f" Axes are logarithmic {' and '.join(logarithmic)}." if logarithmic else ""
    return style.save(figure, file), axes_are


def base(kept: HandTrack, ours: HandTrack, file: Path) -> Path:
    """What the base's motion does to the hand where the CoM stays, and beside it where the CoM goes with the arm."""
    figure = style.figure(11.0, 6.0)
    grid = figure.add_gridspec(2, 2, left=0.06, right=0.985, bottom=0.09, top=0.79, hspace=0.42, wspace=0.1)
    top = 115.0 * float(max(np.abs(track.base_error.position).max() for track in (kept, ours)))
    farthest = [100.0 * float(track.base_error.distance.max()) for track in (kept, ours)]
    for column, (track, name) in enumerate(((kept, "the CoM stays"), (ours, "the CoM goes with the arm"))):
        at, moved = track.time - track.time[0], track.base_error
        above, below = figure.add_subplot(grid[0, column]), figure.add_subplot(grid[1, column])
        style.quiet(above, f"{name}: by axis", "", "[cm]" if not column else "")
        for i, axis in enumerate(_AXES):
            above.plot(at, 100.0 * moved.position[:, i], color=style.SERIES[i], linewidth=1.3, label=axis)
        style.quiet(below, f"{name}: distance", "robot time [s]", "[cm]" if not column else "")
        below.plot(at, 100.0 * moved.distance, color=style.MEASURED, linewidth=1.6)
        above.set_ylim(-top, top)
        below.set_ylim(0.0, 1.1 * max(farthest))
        for axes in (above, below):
            axes.set_xlim(at[0], at[-1])
            make_room(axes)
            bands(axes, at, track.behavior, label=False)
    handles = [style.sample(axis, style.SERIES[i], 1.8) for i, axis in enumerate(_AXES)]
    key(figure, [*handles, *keys(np.concatenate([kept.behavior, ours.behavior]))])
    told = f"at most {farthest[0]:.1f} cm, and {farthest[1]:.1f} cm where the CoM goes with the arm"
    style.heading(figure, "What the floating base does to the hand", told)
    return style.save(figure, file)


def shares(track: HandTrack, file: Path) -> Path:
    """The whole error and the floating base's part over time: components above, magnitudes below (figure 5.15)."""
    figure, (above, below) = _two_panels()
    at = track.time - track.time[0]
    parts = (("from the goal", track.total_error, "-"), ("by the floating base", track.base_error, "--"))
    limit = 0.0
    for name, error, line in parts:
        for i, axis in enumerate(_AXES):
            label = axis if line == "-" else None
            above.plot(at, 100.0 * error.position[:, i], line, color=style.SERIES[i], linewidth=1.3, label=label)
        below.plot(at, 100.0 * error.distance, line, color=style.INK, linewidth=1.4, label=name)
        settled = np.any([track.settled(motion) for motion in track.motions], axis=0)
        limit = max(limit, 100.0 * float(error.distance[settled].max(initial=0.05)))
    for axes, title in ((above, "components: solid from the goal, dashed by the base"), (below, "magnitudes")):
        style.quiet(axes, title, "robot time [s]" if axes is below else "", "[cm]")
        axes.set_xlim(at[0], at[-1])
        axes.set_ylim(-1.5 * limit if axes is above else -0.25 * limit, 1.5 * limit)  # below: the bands
        _name(axes, at, track)
    told = f"at rest at most {limit:.1f} cm; what is farther, on the way to a new goal, is cut off"
    style.heading(figure, "Whose error it is", told)
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


def poses(recording: Recording, track: HandTrack, names: Sequence[str], file: Path, *, fixed: bool = False) -> Path:
    """The robot at rest at some poses, and a ghost with the goal's arm on the base where it was at first.

    The base is the floating one, or ``fixed`` where it was at first. The line is the hand's way; above stands how far
    hand and torso are off.
    """
    hand, off_by = (track.fixed, PoseError.of(track.fixed, track.reference)) if fixed else (
        track.floating, track.total_error,
    )  # fmt: skip
    motions = {motion.name: motion for motion in track.motions}
    chosen = [motions[name] for name in names if name in motions]
    width, height = _PANEL
    with closing(Scene(recording.robot, width, height, *recording.world)) as scene:
        images = []
        for motion in chosen:
            posture = recording.posture(motion.end)
            ghost = _wanted(recording, track, motion)
            if fixed:
                posture = replace(ghost, joint_position=_with_arm(recording, ghost, posture.joint_position, motion))
            scene.look_at(posture.pelvis_position * (1.0, 1.0, 0.0) + _MIDDLE, distance=3.1, azimuth=140.0)
            way = hand.position[(track.time >= motion.start) & (track.time <= motion.end)][::_THIN]
            seen = scene.draw(posture, marks.trace(way, style.MEASURED, 0.005)).astype(float)
            images.append((seen + _GHOST * (scene.draw(ghost) - seen)).round().astype(np.uint8))
    header = 84
    figure = style.figure(len(chosen) * width / _DPI, (height + header) / _DPI, _DPI)
    share = height / (height + header)
    for i, (motion, image) in enumerate(zip(chosen, images, strict=True)):
        figure.figimage(image, xo=i * width, yo=0, origin="upper")
        rest = track.settled(motion)
        moved = 100.0 * float(track.base_error.distance[rest].mean())
        off = 100.0 * float(off_by.distance[rest].mean())
        middle, top = (i + 0.5) / len(chosen), share + (1.0 - share) * 0.66
        figure.text(middle, top, motion.name, ha="center", va="center", fontsize=15, color=style.INK, weight="bold")
        text = f"hand off by {off:.1f} cm" + ("" if fixed else f"; the torso gave way by {moved:.1f} cm")
        figure.text(middle, top - (1.0 - share) * 0.36, text, ha="center", va="center", fontsize=9.5, color=style.GREY)
    return style.save(figure, file, _DPI)


def _wanted(recording: Recording, track: HandTrack, motion: Motion) -> Posture:
    """The robot with a motion's goal reached and its base where it was when all began."""
    first, robot = recording.posture(float(track.time[0])), recording.robot
    joints = first.joint_position.copy()
    for joint, goal in motion.goal.items():
        joints[robot.index[joint]] = goal
    return replace(first, joint_position=joints)


def _with_arm(recording: Recording, posture: Posture, measured: FloatArray, motion: Motion) -> FloatArray:
    """(n,) joints of a posture, those of a motion as measured."""
    joints = posture.joint_position.copy()
    arm = [recording.robot.index[joint] for joint in motion.goal]
    joints[arm] = measured[arm]
    return joints


def _two_panels() -> tuple[Figure, tuple[Axes, Axes]]:
    """A figure, and its axes: above, below."""
    figure = style.figure(11.0, 5.8)
    grid = figure.add_gridspec(2, 1, left=0.07, right=0.985, bottom=0.09, top=0.80, hspace=0.42)
    return figure, (figure.add_subplot(grid[0]), figure.add_subplot(grid[1]))


def _finish(axes: Axes, at: FloatArray, values: FloatArray) -> None:
    axes.set_xlim(at[0], at[-1])
    low, high = float(values.min()), float(values.max())
    room = max(high - low, 1e-3)
    axes.set_ylim(low - 0.18 * room, high + 0.12 * room)  # below: the bands


def _show_small(axes: Axes, values: FloatArray) -> bool:
    """Where values reach far beyond those at rest, draw what lies beyond one unit by its logarithm; returns whether."""
    largest = float(np.abs(values).max())
    if largest < _FAR:
        return False
    axes.set_yscale("symlog", linthresh=1.0, linscale=1.0)
    ticks = [0.0, *(sign * 10.0**power for power in range(int(np.log10(largest)) + 1) for sign in (-1.0, 1.0))]
    axes.set_yticks(sorted(ticks), [f"{tick:g}" for tick in sorted(ticks)])
    axes.minorticks_off()
    axes.set_ylim(-5.0 * largest, 2.0 * largest)  # below: the bands
    return True


def _name(axes: Axes, at: FloatArray, track: HandTrack, columns: int = 3, top: float = 1.24) -> None:
    """The behaviors below, a thin line where each motion begins, and the legend above."""
    bands(axes, at, track.behavior)
    for motion in track.motions:
        axes.axvline(motion.start - track.time[0], color=style.LIGHT, linewidth=0.9, zorder=0.6)
    legend_above(axes, columns, top)
