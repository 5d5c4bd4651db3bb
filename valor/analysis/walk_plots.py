"""A walk in pictures: its path over the ground, the DCM and the foot forces over time, the robot on its way."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import matplotlib.image
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from matplotlib.patches import Polygon

from valor.analysis import style
from valor.analysis.bag import Bag
from valor.analysis.recording import Recording, nearest
from valor.analysis.walk import Figures, Footprint, Track, footprints, runs
from valor.common.arrays import FloatArray
from valor.common.topics import GROUND_TRUTH, MOTION_STATE
from valor.drawing.scene import Scene
from valor.robot.description import RobotDescription
from valor.robot.tables import Foot
from valor.simulation import worlds

STRIP = 16.0  # of the ground, shown in one row [m]
MARGIN = 1.0  # around the path [m]
GRID = 0.05  # of the ground's heights [m]
CLOSE_UP = 6.0  # of the walk, in which single steps are seen [s]
PICTURE = (1280, 800)  # [pixels]
_TIME = "robot time from setting off [s]"
_PATH_LEGEND = [
    style.sample("pelvis, true", style.INK, 1.3),
    style.sample("estimated", style.INK, 0.9, linestyle=style.DASHES),
    style.sample("left sole", style.LEFT, 5.0),
    style.sample("right sole", style.RIGHT, 5.0),
]


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
    ground = _Ground(recording, low, high)
    width = 12.5
    row_height = (width - 1.9) * (high[1] - low[1]) / length + 0.28
    height = 1.25 + rows * row_height + 0.3
    figure = style.figure(width, height)
    grid = figure.add_gridspec(
        rows, 1, left=0.06, right=0.89, bottom=0.48 / height, top=1.0 - 0.95 / height, hspace=0.28 / row_height
    )
    for row in range(rows):
        axes = figure.add_subplot(grid[row])
        begin = low[0] + row * length
        style.quiet(axes, "", "x [m]" if row == rows - 1 else "", "y [m]")
        shown = ground.draw(axes)
        for each in prints:
            axes.add_patch(_sole(each, robot.tables.feet.left if each.left else robot.tables.feet.right))
        style.curve(axes, true[:, 0], true[:, 1], style.INK, 1.3)
        style.curve(axes, believed[:, 0], believed[:, 1], style.INK, 0.9, linestyle=style.DASHES)
        axes.set_xlim(begin, begin + length)
        axes.set_ylim(low[1], high[1])
        axes.set_aspect("equal")
    bar = figure.colorbar(shown, cax=figure.add_axes((0.91, 0.48 / height, 0.012, 1.0 - 1.43 / height)))
    bar.set_label("height of the ground [cm]", fontsize=9, color=style.GREY)
    bar.ax.tick_params(colors=style.GREY, labelsize=8)
    bar.outline.set_visible(False)
    way, off = float(np.linalg.norm(true[-1, :2] - true[0, :2])), believed[-1, :2] - true[-1, :2]
    title = f"{robot.name.upper()}: {way:.1f} m over {recording.world[0]}, {len(prints)} footprints"
    style.heading(figure, title, f"at the end the robot believes to be {np.linalg.norm(off):.2f} m from where it is")
    style.legend(figure, _PATH_LEGEND, loc="upper right", bbox_to_anchor=(0.995, 1.0 - 0.1 / height), ncols=4)
    return [style.save(figure, out / "path.png")]


class _Ground:
    """The ground by its height, as one picture that every row shows a strip of."""

    def __init__(self, recording: Recording, low: FloatArray, high: FloatArray) -> None:
        """From a corner to the opposite one, (2,) in world [m]."""
        x, y = np.arange(low[0], high[0], GRID), np.arange(low[1], high[1], GRID)
        self._heights = worlds.heights(*recording.world, x, y, worlds.size_of(recording.robot))
        self._extent = (x[0], x[-1], y[0], y[-1])
        self._scale = 100.0 * max(0.02, float(np.abs(self._heights).max()))  # [cm]

    def draw(self, axes: Axes) -> AxesImage:
        axes.grid(False)
        return axes.imshow(
            100.0 * self._heights, extent=self._extent, origin="lower", cmap=style.GROUND, vmin=-self._scale,
            vmax=self._scale, interpolation="bilinear",
        )  # fmt: skip


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
    _whole_walk(figure.add_subplot(grid[0]), figure.add_subplot(grid[1]), walk, at)
    begin = max(0.0, 0.5 * (at[-1] - CLOSE_UP))
    near = (at >= begin) & (at <= begin + CLOSE_UP)
    _dcm_close_up(figure.add_subplot(grid[2]), recording, at[near] + first, first)
    _forces_close_up(figure.add_subplot(grid[3]), walk, at, near)
    x, y, z = (1e3 * each for each in figures.dcm_error)
    style.heading(
        figure,
        f"{robot.name.upper()}: {figures.distance:.1f} m in {figures.duration:.0f} s",
        f"DCM error {x:.1f}, {y:.1f}, {z:.1f} mm rms (x, y, z); smallest knee angle {figures.knee:.2f} rad; vertical "
        f"forces planned against measured {figures.force_error:.0f} N rms",
    )
    return [style.save(figure, out / "dynamics.png")]


def _whole_walk(errors: Axes, forces: Axes, walk: Track, at: FloatArray) -> None:
    """Second by second: the DCM's error above, the largest forces below."""
    seconds = np.arange(max(1, math.ceil(at[-1])))
    of_second = [np.minimum(at.astype(int), seconds[-1]) == second for second in seconds]

    def each(function: Callable[[FloatArray], float], values: FloatArray) -> FloatArray:
        return np.array([function(values[rows]) if rows.any() else np.nan for rows in of_second])

    beside = 1e3 * np.linalg.norm(walk.dcm_error[:, :2], axis=1)
    mean = each(np.mean, beside)
    style.quiet(errors, "DCM from its reference, mean and largest of each second", "", "[mm]")
    errors.fill_between(seconds + 0.5, mean, each(np.max, beside), color=style.COMMAND, alpha=0.25, linewidth=0,
                        label="up to the largest")  # fmt: skip
    style.curve(errors, seconds + 0.5, mean, style.COMMAND, 1.6, label="mean")
    style.legend_above(errors, 2, 1.28)
    style.quiet(forces, "largest vertical force under each foot in each second", _TIME, "[N]")
    for foot, (name, color) in enumerate((("left", style.LEFT), ("right", style.RIGHT))):
        style.curve(forces, seconds + 0.5, each(np.max, walk.measured_force[:, foot]), color, 1.3, label=name)
    style.legend_above(forces, 2, 1.28)
    for axes in (errors, forces):
        axes.set_xlim(0.0, at[-1])
        axes.set_ylim(bottom=0.0)


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
    middle = [0.5 * (track.time[a] + track.time[b]) for a, b in runs(light) if b - a > 50]
    return float(min(middle, key=lambda time: abs(time - near), default=near))


def _dcm_close_up(axes: Axes, recording: Recording, times: FloatArray, first: float) -> None:
    states = recording.series(MOTION_STATE)
    rows = np.unique(nearest(states.time, times))
    style.quiet(axes, "DCM, its reference and the CoM, across the way", "", "y [cm]")
    at = states.time[rows] - first
    lines = (("dcm_in_odom", style.MEASURED, 1.6, "-", "DCM"), ("com_in_odom", style.COMMAND, 1.6, "-", "CoM"),
             ("dcm_reference_in_odom", style.INK, 0.8, style.DASHES, "DCM's reference"))  # fmt: skip
    for field, color, width, dashes, name in lines:
        style.curve(axes, at, 100.0 * states[field][rows, 1], color, width, linestyle=dashes, label=name)
    axes.set_xlim(at[0], at[-1])
    style.legend_above(axes, 3, 1.28)


def _forces_close_up(axes: Axes, walk: Track, at: FloatArray, near: npt.NDArray[np.bool_]) -> None:
    style.quiet(axes, "vertical force under each foot, planned and measured", _TIME, "[N]")
    for foot, color, name in ((0, style.LEFT, "left"), (1, style.RIGHT, "right")):
        style.curve(axes, at[near], walk.measured_force[near, foot], color, 1.6, label=f"{name}, measured")
        style.curve(axes, at[near], walk.desired_force[near, foot], style.INK, 0.8, linestyle=style.DASHES,
                    label="planned" if foot else None)  # fmt: skip
    axes.set_xlim(at[near][0], at[near][-1])
    style.legend_above(axes, 3, 1.28)


def _sole(footprint: Footprint, foot: Foot) -> Polygon:
    corners = np.array([(foot.heel, -foot.half_width), (foot.toe, -foot.half_width), (foot.toe, foot.half_width),
                        (foot.heel, foot.half_width)])  # fmt: skip
    cos, sin = math.cos(footprint.heading), math.sin(footprint.heading)
    turned = corners @ np.array([[cos, sin], [-sin, cos]]) + footprint.position[:2]
    color = style.LEFT if footprint.left else style.RIGHT
    return Polygon(turned, closed=True, facecolor=color, alpha=0.55, edgecolor="white", linewidth=0.3)
