"""Plots of a walk."""

import math
from contextlib import closing
from pathlib import Path

import matplotlib.image
import numpy as np
from matplotlib.patches import Polygon

from valor.analysis import style
from valor.analysis.reading.bag import Bag
from valor.analysis.reading.recording import Recording
from valor.analysis.walk.track import Footprint, Track, WalkMetrics, footprints, runs
from valor.common.topics import GROUND_TRUTH, MOTION_STATE
from valor.drawing.scene import Scene
from valor.robot.description import RobotDescription
from valor.robot.tables import Foot
from valor.simulation import worlds

STRIP = 16.0  # length of ground in one row [m]
MARGIN = 1.0  # around the path [m]
GRID = 0.05  # of the ground's heights [m]
PICTURE = (1280, 800)  # [pixels]
_PATH_LEGEND = [
    style.sample("pelvis, true", style.INK, 1.3),
    style.sample("estimated", style.INK, 0.9, linestyle=style.DASHES),
    style.sample("left sole", style.LEFT, 5.0),
    style.sample("right sole", style.RIGHT, 5.0),
]


def path(bag: Bag | Path, robot: RobotDescription, out: Path) -> list[Path]:
    """Plot ground, footprints, true and estimated path of the pelvis from above into ``path.png``.

    Raises BagError: the bag is damaged or lacks a topic; names it.
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
    heights = 100.0 * worlds.heights(*recording.world, x, y, worlds.size_of(robot))  # [cm]
    scale = max(2.0, float(np.abs(heights).max()))
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
        axes.grid(False)
        shown = axes.imshow(
            heights, extent=(x[0], x[-1], y[0], y[-1]), origin="lower", cmap=style.GROUND, vmin=-scale, vmax=scale,
            interpolation="bilinear",
        )  # fmt: skip
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
    style.heading(figure, title, f"error of the estimated position at the end {np.linalg.norm(off):.2f} m")
    style.legend(figure, _PATH_LEGEND, loc="upper right", bbox_to_anchor=(0.995, 1.0 - 0.1 / height), ncols=4)
    return [style.save(figure, out / "path.png")]


def dynamics(bag: Bag | Path, robot: RobotDescription, out: Path) -> list[Path]:
    """Plot path, DCM error, foot forces and knees over time into ``dynamics.png``; raises BagError as ``path``."""
    track = Track.of(Recording(Bag.of(bag), robot))
    walk = track.between(*track.walk())
    metrics = WalkMetrics.of(walk)
    x, y, z = (1e3 * each for each in metrics.dcm_error)
    title = f"{robot.name.upper()}: {metrics.distance:.1f} m in {metrics.duration:.0f} s"
    subtitle = (
        f"DCM error {x:.1f}, {y:.1f}, {z:.1f} mm rms (x, y, z); smallest knee angle {metrics.knee:.2f} rad; vertical "
        f"forces planned against measured {metrics.force_error:.0f} N rms"
    )
    figure = style.figure(10.0, 8.0)
    style.heading(figure, title, subtitle)
    way, error, force, knee = figure.subplots(
        4, 1, gridspec_kw={"left": 0.08, "right": 0.97, "top": 0.89, "bottom": 0.07, "hspace": 0.55}
    )
    time = walk.time - walk.time[0]
    style.quiet(way, "pelvis from above, from its start", "x in odom [m]", "y [m]")
    path = walk.pelvis - walk.pelvis[0]
    style.curve(way, path[:, 0], path[:, 1], style.INK, 1.3)
    way.set_aspect("equal", adjustable="datalim")
    style.quiet(error, "DCM from its reference", "", "[mm]")
    style.curve(error, time, 1e3 * np.linalg.norm(walk.dcm_error[:, :2], axis=1), style.INK, 1.0)
    style.quiet(force, "vertical foot force: measured, and planned (dashed)", "", "[N]")
    style.quiet(knee, "knee angle", "robot time [s]", "[rad]")
    for side, colour in ((0, style.LEFT), (1, style.RIGHT)):
        style.curve(force, time, walk.measured_force[:, side], colour, 1.0)
        style.curve(force, time, walk.desired_force[:, side], colour, 0.8, linestyle=(0, (3, 2)))
        style.curve(knee, time, walk.knee[:, side], colour, 1.0)
    names = [style.sample("left", style.LEFT, 1.5), style.sample("right", style.RIGHT, 1.5)]
    style.legend(figure, names, loc="upper right", ncols=2)
    return [style.save(figure, out / "dynamics.png")]


def picture(bag: Bag | Path, robot: RobotDescription, out: Path) -> list[Path]:
    """Draw the robot at its true pose into ``on_the_way.png``, in a step near the middle of the walk.

    Raises BagError as ``path``, and RenderingError without off-screen OpenGL.
    """
    recording = Recording(Bag.of(bag), robot)
    track = Track.of(recording)
    first, last = track.walk()
    posture = recording.posture(_in_mid_step(track, 0.5 * (first + last)))
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
    light = track.measured_force.min(axis=1) < 20.0
    middle = [0.5 * (track.time[a] + track.time[b]) for a, b in runs(light) if b - a > 50]
    return float(min(middle, key=lambda time: abs(time - near), default=near))


def _sole(footprint: Footprint, foot: Foot) -> Polygon:
    corners = np.array([(foot.heel, -foot.half_width), (foot.toe, -foot.half_width), (foot.toe, foot.half_width),
                        (foot.heel, foot.half_width)])  # fmt: skip
    cos, sin = math.cos(footprint.heading), math.sin(footprint.heading)
    turned = corners @ np.array([[cos, sin], [-sin, cos]]) + footprint.position[:2]
    color = style.LEFT if footprint.left else style.RIGHT
    return Polygon(turned, closed=True, facecolor=color, alpha=0.55, edgecolor="white", linewidth=0.3)
