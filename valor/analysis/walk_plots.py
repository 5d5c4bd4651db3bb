"""A walk in pictures: its path over the ground, the DCM and the foot forces over time, the robot on its way."""

from __future__ import annotations

import math
from contextlib import closing
from pathlib import Path

import matplotlib.image
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from valor.analysis import style
from valor.analysis.bag import Bag
from valor.analysis.recording import Recording, nearest
from valor.analysis.scene import Scene
from valor.analysis.walk import Figures, Footprint, Track, footprints
from valor.common.arrays import FloatArray
from valor.common.topics import GROUND_TRUTH, MOTION_STATE
from valor.robot.description import RobotDescription
from valor.robot.tables import Foot
from valor.simulation import worlds

STRIP = 16.0  # of the ground, shown in one row [m]
MARGIN = 1.0  # around the path [m]
GRID = 0.05  # of the ground's heights [m]
CLOSE_UP = 6.0  # of the walk, in which single steps are seen [s]
PICTURE = (1280, 800)  # [pixels]
_LEFT, _RIGHT = style.SERIES[0], style.SERIES[1]


def path(bag: Bag | Path, robot: RobotDescription, out: Path) -> list[Path]:
    """The path from above: ground by height, every footprint, the pelvis' true way and the one the robot believes in.

    Args:
        bag: the recording, with the simulator's truth.
        robot: whose it is.
        out: the folder for ``path.png``.

    Returns:
        The file made.

    Raises:
        BagError: the bag is broken or lacks a topic; names it.
    """
    recording = Recording(Bag.of(bag), robot)
    recording.load(GROUND_TRUTH, MOTION_STATE)
    prints = footprints(recording)
    true = recording.series(GROUND_TRUTH)["pelvis_position_in_world"]
    believed = recording.series(MOTION_STATE)["pelvis_position_in_odom"]
    places = np.vstack([true[:, :2], [each.position[:2] for each in prints]])
    low, high = places.min(axis=0) - MARGIN, places.max(axis=0) + MARGIN
    rows = max(1, math.ceil((high[0] - low[0]) / STRIP))
    length = (high[0] - low[0]) / rows
    x, y = np.arange(low[0], high[0], GRID), np.arange(low[1], high[1], GRID)
    ground = worlds.heights(*recording.world, x, y)
    width = 12.5
    row_height = (width - 1.9) * (high[1] - low[1]) / length + 0.28
    height = 1.25 + rows * row_height + 0.3
    figure = style.figure(width, height)
    grid = figure.add_gridspec(
        rows, 1, left=0.05, right=0.90, bottom=0.48 / height, top=1.0 - 0.95 / height, hspace=0.28 / row_height
    )
    soles = (robot.tables.feet.left, robot.tables.feet.right)
    scale = max(0.02, float(np.abs(ground).max()))
    for row in range(rows):
        axes = figure.add_subplot(grid[row])
        begin = low[0] + row * length
        style.quiet(axes, "", "x [m]" if row == rows - 1 else "", "y [m]")
        axes.grid(False)
        shown = axes.imshow(
            100.0 * ground, extent=(x[0], x[-1], y[0], y[-1]), origin="lower", cmap="BrBG_r", vmin=-100.0 * scale,
            vmax=100.0 * scale, alpha=0.75, interpolation="bilinear",
        )  # fmt: skip
        for each in prints:
            axes.add_patch(_sole(each, soles[0] if each.left else soles[1]))
        style.curve(axes, true[:, 0], true[:, 1], style.INK, 1.3)
        style.curve(axes, believed[:, 0], believed[:, 1], style.INK, 0.9, linestyle=(0, (2, 2)))
        axes.set_xlim(begin, begin + length)
        axes.set_ylim(low[1], high[1])
        axes.set_aspect("equal")
    bar = figure.colorbar(shown, cax=figure.add_axes((0.92, 0.48 / height, 0.012, 1.0 - 1.43 / height)))
    bar.set_label("height of the ground [cm]", fontsize=9, color=style.GREY)
    bar.ax.tick_params(colors=style.GREY, labelsize=8)
    bar.outline.set_visible(False)
    way = float(np.linalg.norm(true[-1, :2] - true[0, :2]))
    off = believed[-1, :2] - true[-1, :2]
    style.heading(
        figure,
        f"{robot.name.upper()}: {way:.1f} m over {recording.world[0]}, {len(prints)} footprints",
        f"at the end the robot believes to be {np.linalg.norm(off):.2f} m from where it is",
    )
    style.legend(
        figure,
        [
            Line2D([], [], color=style.INK, linewidth=1.3, label="pelvis, true"),
            Line2D([], [], color=style.INK, linewidth=0.9, linestyle=(0, (2, 2)), label="estimated"),
            Line2D([], [], color=_LEFT, linewidth=5, label="left sole"),
            Line2D([], [], color=_RIGHT, linewidth=5, label="right sole"),
        ],
        loc="upper right",
        bbox_to_anchor=(0.995, 1.0 - 0.1 / height),
        ncols=4,
    )
    return [style.save(figure, out / "path.png")]


def dynamics(bag: Bag | Path, robot: RobotDescription, out: Path) -> list[Path]:
    """The DCM's error and the forces under the feet over the whole walk, and both closer over a few steps.

    Args:
        bag: the recording.
        robot: whose it is.
        out: the folder for ``dynamics.png``.

    Returns:
        The file made.

    Raises:
        BagError: the bag is broken or lacks a topic; names it.
    """
    recording = Recording(Bag.of(bag), robot)
    track = Track.of(recording)
    first, last = track.walk()
    walk = track.between(first, last)
    figures = Figures.of(walk)
    at = walk.time - first
    figure = style.figure(12.5, 9.6)
    grid = figure.add_gridspec(4, 1, left=0.065, right=0.985, bottom=0.06, top=0.89, hspace=0.5)
    errors = figure.add_subplot(grid[0])
    style.quiet(errors, "DCM from its reference, mean and largest of each second", "", "[mm]")
    seconds = np.arange(max(1, math.ceil(at[-1])))
    beside = 1e3 * np.linalg.norm(walk.dcm_error[:, :2], axis=1)
    groups = np.minimum(at.astype(int), seconds[-1])
    largest, mean = (np.array([f(beside[groups == s]) if (groups == s).any() else np.nan for s in seconds])
                     for f in (np.max, np.mean))  # fmt: skip
    errors.fill_between(seconds + 0.5, mean, largest, color=style.COMMAND, alpha=0.25, linewidth=0)
    style.curve(errors, seconds + 0.5, mean, style.COMMAND, 1.6)
    forces = figure.add_subplot(grid[1])
    style.quiet(
        forces, "largest vertical force under each foot in each second", "robot time from setting off [s]", "[N]"
    )
    for foot, color in enumerate((_LEFT, _RIGHT)):
        peaks = np.array([walk.measured_force[groups == s, foot].max() if (groups == s).any() else np.nan
                          for s in seconds])  # fmt: skip
        style.curve(forces, seconds + 0.5, peaks, color, 1.3)
    for axes in (errors, forces):
        axes.set_xlim(0.0, at[-1])
        axes.set_ylim(bottom=0.0)
    begin = max(0.0, 0.5 * (at[-1] - CLOSE_UP))
    near = (at >= begin) & (at <= begin + CLOSE_UP)
    _dcm_close_up(figure.add_subplot(grid[2]), recording, at[near] + first, first)
    close = figure.add_subplot(grid[3])
    style.quiet(close, "vertical force under each foot, planned and measured", "robot time from setting off [s]", "[N]")
    for foot, color, name in ((0, _LEFT, "left"), (1, _RIGHT, "right")):
        style.curve(close, at[near], walk.measured_force[near, foot], color, 1.6, label=f"{name}, measured")
        style.curve(close, at[near], walk.desired_force[near, foot], style.INK, 0.8, linestyle=(0, (2, 2)),
              label="planned" if foot else None)  # fmt: skip
    close.set_xlim(at[near][0], at[near][-1])
    style.legend(close, close.get_legend_handles_labels()[0], loc="upper right", bbox_to_anchor=(1.0, 1.28), ncols=3)
    x, y, z = (1e3 * each for each in figures.dcm_error)
    style.heading(
        figure,
        f"{robot.name.upper()}: {figures.distance:.1f} m in {figures.duration:.0f} s",
        f"DCM error {x:.1f}, {y:.1f}, {z:.1f} mm rms (x, y, z); smallest knee angle {figures.knee:.2f} rad; vertical "
        f"forces planned against measured {figures.force_error:.0f} N rms",
    )
    return [style.save(figure, out / "dynamics.png")]


def picture(bag: Bag | Path, robot: RobotDescription, out: Path, time: float | None = None) -> list[Path]:
    """The robot on its way, as the simulator had it.

    Args:
        bag: the recording.
        robot: whose it is.
        out: the folder for ``on_the_way.png``.
        time: robot time [s], if another than in the middle of the walk is wanted.

    Returns:
        The file made.

    Raises:
        BagError: the bag is broken or lacks a topic; names it.
        RenderingError: there is no off-screen OpenGL here.
    """
    recording = Recording(Bag.of(bag), robot)
    track = Track.of(recording)
    if time is None:
        first, last = track.walk()
        time = _in_mid_step(track, 0.5 * (first + last))
    posture = recording.posture(time)
    with closing(Scene(robot, *PICTURE, *recording.world)) as scene:
        scene.look_at(
            posture.pelvis_position + np.array([0.6, 0.0, -0.05]), azimuth=142.0, elevation=-12.0, distance=3.9
        )
        image = scene.draw(posture)
    out.mkdir(parents=True, exist_ok=True)
    file = out / "on_the_way.png"
    matplotlib.image.imsave(file, image)
    return [file]


def _in_mid_step(track: Track, near: float) -> float:
    """The time closest to one at which a single foot carries the robot and has done so for a while [s]."""
    light = track.measured_force.min(axis=1) < 20.0
    middle = [0.5 * (track.time[a] + track.time[b]) for a, b in _runs(light) if b - a > 50]
    return float(min(middle, key=lambda time: abs(time - near), default=near))


def _runs(flags: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(np.int8), [0]))))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _dcm_close_up(axes: Axes, recording: Recording, times: FloatArray, first: float) -> None:
    states = recording.series(MOTION_STATE)
    rows = np.unique(nearest(states.time, times))
    style.quiet(axes, "DCM, its reference and the CoM, across the way", "", "y [cm]")
    at = states.time[rows] - first
    lines = (("dcm_in_odom", style.MEASURED, 1.6, "-", "DCM"), ("com_in_odom", style.COMMAND, 1.6, "-", "CoM"),
             ("dcm_reference_in_odom", style.INK, 0.8, (0, (2, 2)), "DCM's reference"))  # fmt: skip
    for field, color, width, dashes, name in lines:
        style.curve(axes, at, 100.0 * states[field][rows, 1], color, width, linestyle=dashes, label=name)
    axes.set_xlim(at[0], at[-1])
    style.legend(axes, axes.get_legend_handles_labels()[0], loc="upper right", bbox_to_anchor=(1.0, 1.28), ncols=3)


def _sole(footprint: Footprint, foot: Foot) -> Polygon:
    corners = np.array([(foot.heel, -foot.half_width), (foot.toe, -foot.half_width), (foot.toe, foot.half_width),
                        (foot.heel, foot.half_width)])  # fmt: skip
    cos, sin = math.cos(footprint.heading), math.sin(footprint.heading)
    turned = corners @ np.array([[cos, sin], [-sin, cos]]) + footprint.position[:2]
    color = _LEFT if footprint.left else _RIGHT
    return Polygon(turned, closed=True, facecolor=color, alpha=0.55, edgecolor="white", linewidth=0.3)
