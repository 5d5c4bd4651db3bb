"""Plots of the joints' tracking from a bag."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from valor.analysis import style
from valor.analysis.bands import bands_of
from valor.analysis.reading.bag import Bag
from valor.analysis.reading.recording import Recording, nearest, recorded
from valor.bags.errors import BagError
from valor.common.arrays import FloatArray
from valor.common.topics import JOINT_SETPOINTS, MOTION_STATE, MOTOR, PROPRIOCEPTOR
from valor.robot.description import RobotDescription

MARGIN = 1.0  # before and after manipulation [s]
STILL = 0.002  # speed below which a set-point is at rest [rad/s]
FRESH = 0.05  # maximum time between a set-point and a measurement compared with it [s]
_COLUMNS = 2


@dataclass(frozen=True)
class _Error:
    joint: str
    time: FloatArray  # (m,) since the window's start [s]
    value: FloatArray  # (m,) measured minus set-point [rad]
    reference: FloatArray  # (m,) the set-point [rad]

    @property
    def rms_at_rest(self) -> float:
        """Root mean square [rad] where the set-point is constant; NaN if it never is."""
        if len(self.time) < 3:
            return math.nan
        still = np.abs(np.gradient(self.reference, self.time)) < STILL
        return float(np.sqrt(np.mean(self.value[still] ** 2))) if still.any() else math.nan


def joint_tracking(bag: Bag | Path, robot: RobotDescription, groups: Iterable[str], out: Path) -> list[Path]:
    """Plot reference, command, measurement and error of every joint over time, into a PNG for each group.

    Raises BagError: the bag is damaged or lacks a topic; names it.
    """
    recording = Recording(Bag.of(bag), robot)
    recording.load(PROPRIOCEPTOR, MOTOR, MOTION_STATE, JOINT_SETPOINTS)
    return [_track_group(recording, group, out) for group in groups]


def _track_group(recording: Recording, group: str, out: Path) -> Path:
    robot = recording.robot
    joints = robot.tables.group(group)
    if not joints:
        has = [name for name, members in robot.tables.groups.items() if members]
        raise BagError(f"robot {robot.name!r} has no joint group {group!r}; it has {', '.join(has)}")
    times, measured = recording.measured()
    command_times, commands = recording.commands()
    setpoints = recording.setpoints()
    first, last = _window(recording, times)
    rows = math.ceil(len(joints) / _COLUMNS)
    height = 1.05 + 1.75 * rows + 2.85
    figure = style.figure(11.0, height)
    grid = figure.add_gridspec(
        rows + 1, _COLUMNS, height_ratios=[1.0] * rows + [1.45], left=0.075, right=0.985,
        bottom=0.85 / height, top=1.0 - 1.12 / height, hspace=0.55, wspace=0.16,
    )  # fmt: skip
    errors: list[_Error] = []
    shown = (times >= first) & (times <= last)
    commanded = (command_times >= first) & (command_times <= last)
    for i, joint in enumerate(joints):
        axes = figure.add_subplot(grid[i // _COLUMNS, i % _COLUMNS])
        column = robot.index[joint]
        label = "position [rad]" if i % _COLUMNS == 0 else ""
        style.quiet(axes, joint, "", label)
        axes.set_xlim(0.0, last - first)
        style.curve(axes, times[shown] - first, measured[shown, column], style.MEASURED, 2.2)
        style.curve(axes, command_times[commanded] - first, commands[commanded, column], style.COMMAND, 1.3)
        if joint in setpoints:
            at, reference = setpoints[joint]
            near = (at >= first) & (at <= last)
            style.curve(axes, at[near] - first, reference[near], style.REFERENCE, 1.1, linestyle=(0, (4, 2)))
            fresh = np.abs(times - at[nearest(at, times)]) < FRESH
            covered = shown & fresh
            desired = np.interp(times[covered], at, reference)
            errors.append(_Error(joint, times[covered] - first, measured[covered, column] - desired, desired))
        low, high = axes.get_ylim()
        if high - low < 0.1:  # noise of a joint at rest must not look like motion
            middle = (low + high) / 2.0
            axes.set_ylim(middle - 0.05, middle + 0.05)
        bands_of(axes, recording, first, last, label=False)
    errors_axes = figure.add_subplot(grid[rows, :])
    _plot_errors(errors_axes, errors, last - first)
    bands_of(errors_axes, recording, first, last)
    _head(figure, f"{robot.name.upper()}: tracking of the {group.replace('_', ' ')}", errors)
    return style.save(figure, out / f"joint_tracking_{group}.png")


def _head(figure: Figure, title: str, errors: list[_Error]) -> None:
    """Add the title, the errors' metrics and the legend of curves above the plots."""
    largest = max((float(np.abs(error.value).max()) for error in errors if error.value.size), default=math.nan)
    at_rest = max((error.rms_at_rest for error in errors if error.value.size), default=math.nan)
    style.heading(
        figure,
        title,
        f"largest error {1e3 * largest:.1f} mrad; at rest {1e3 * at_rest:.2f} mrad rms of the worst joint",
    )
    style.legend(
        figure,
        [
            style.sample("set-point (ROS side)", style.REFERENCE, 1.1, linestyle=(0, (4, 2))),
            style.sample("motor command", style.COMMAND, 1.3),
            style.sample("measured", style.MEASURED, 2.2),
        ],
        loc="upper right",
        bbox_to_anchor=(0.99, 1.0 - 0.12 / figure.get_figheight()),
        ncols=3,
    )


def _plot_errors(axes: Axes, errors: list[_Error], end: float) -> None:
    style.quiet(axes, "error: measured − set-point", "robot time from the window's start [s]", "[mrad]")
    axes.set_xlim(0.0, end)
    axes.axhline(0.0, color=style.GREY, linewidth=0.8)
    for error, color in zip(errors, style.SERIES, strict=False):
        style.curve(axes, error.time, 1e3 * error.value, color, 1.2, label=error.joint)
    if errors:
        handles, _ = axes.get_legend_handles_labels()
        style.legend(axes, handles, loc="upper center", bbox_to_anchor=(0.5, -0.24), ncols=len(errors))
    else:
        axes.text(0.5, 0.5, "no set-points for these joints", transform=axes.transAxes, ha="center", color=style.GREY)


def _window(recording: Recording, times: FloatArray) -> tuple[float, float]:
    """Interval shown [s]: manipulation with a margin, or the whole recording if there is none."""
    if not times.size:
        raise BagError(f"{recording.bag.path}: no messages on {recorded(PROPRIOCEPTOR)}")
    span = recording.manipulation() or (float(times[0]), float(times[-1]))
    return max(float(times[0]), span[0] - MARGIN), min(float(times[-1]), span[1] + MARGIN)
