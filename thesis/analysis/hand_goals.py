"""Where a hand came to rest after each of many goals, on a base that is taken to stay and on one that floats (5.4)."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from thesis.analysis.end_effector import HandTrack, PoseError, Poses
from valor.analysis import style
from valor.analysis.reading.recording import Recording
from valor.bags.errors import BagError
from valor.common.arrays import FloatArray
from valor.common.topics import HAND_GOAL, HAND_GOAL_STATUS

_ODOM = "odom"


@dataclass(frozen=True)
class Arrival:
    """One goal, at rest.

    Attributes:
        name: of the motion.
        state: that the Motion System told of the hand at last; empty where it did not lead it.
        reason: that it gave.
        arm: distance from the goal, were the base where it was [m].
        base: by which the base's motion moved the hand [m].
        distance: from the goal [m].
        angle: from the goal's orientation [rad].
    """

    name: str
    state: str
    reason: str
    arm: float
    base: float
    distance: float
    angle: float


def arrivals(track: HandTrack) -> list[Arrival]:
    """Of a track whose reference is the goals."""
    arm, base, total = PoseError.of(track.fixed, track.reference), track.base_error, track.total_error
    angle = total.angle
    made = []
    for motion in track.motions:
        rest = track.settled(motion)
        if not rest.any():
            raise BagError(f"the recording ends before {motion.name} is at rest")
        by_arm, by_base, distance = (float(each.distance[rest].mean()) for each in (arm, base, total))
        made.append(Arrival(motion.name, "", "", by_arm, by_base, distance, float(angle[rest].mean())))
    return made


def led_arrivals(track: HandTrack, recording: Recording, hand: int) -> list[Arrival]:
    """Of motions in which the Motion System led a hand (0 left, 1 right) to poses in odom.

    Raises:
        BagError: the bag has no such goals, or none before a motion's end.
    """
    recording.load(HAND_GOAL, HAND_GOAL_STATUS)
    goals, told = recording.series(HAND_GOAL), recording.series(HAND_GOAL_STATUS)
    asked = [i for i, each in enumerate(goals.messages) if each.hand == hand and each.active and each.frame == _ODOM]
    said = [i for i, each in enumerate(told.messages) if each.hand == hand]
    position, rotation = track.reference.position.copy(), track.reference.rotation.copy()
    last = []
    for motion in track.motions:
        resting = motion.rest[0]
        before = [i for i in asked if goals.time[i] <= resting]
        heard = [i for i in said if told.time[i] <= resting]
        if not before or not heard:
            raise BagError(f"{recording.bag.path}: no goal of the hand in {_ODOM} for {motion.name}")
        goal = goals.messages[before[-1]]
        during = (track.time >= motion.start) & (track.time <= motion.end)
        position[during], rotation[during] = goal.position, _matrix(goal.orientation)
        last.append(told.messages[heard[-1]])
    there = arrivals(replace(track, reference=Poses(position, rotation)))
    return [replace(each, state=end.state, reason=end.reason) for each, end in zip(there, last, strict=True)]


def write_csv(found: Mapping[str, Sequence[Arrival]], file: Path) -> Path:
    """A row a goal."""
    with open(file, "w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(("way", "goal", "state", "arm_m", "base_m", "distance_m", "angle_rad"))
        for way, there in found.items():
            for one in there:
                numbers = (one.arm, one.base, one.distance, one.angle)
                writer.writerow((way, one.name, one.state, *(f"{value:.6f}" for value in numbers)))
    return file


def plot(found: Mapping[str, Sequence[Arrival]], file: Path) -> Path:
    """How many of the goals the hand came how near to, by place and by orientation: a line a way of going there."""
    figure = style.figure(11.0, 4.4)
    grid = figure.add_gridspec(1, 2, left=0.065, right=0.985, bottom=0.24, top=0.79, wspace=0.14)
    for column, (title, unit) in enumerate((("place", "[cm]"), ("orientation", "[°]"))):
        axes = figure.add_subplot(grid[column])
        style.quiet(axes, title, f"from the goal at rest {unit}", "share of goals [%]" if not column else "")
        for (way, there), color in zip(found.items(), style.SERIES, strict=False):
            far = [np.rad2deg(one.angle) if column else 100.0 * one.distance for one in there]
            values = np.sort([0.0, *far])
            share = np.linspace(0.0, 100.0, len(values))
            axes.step(values, share, where="post", color=color, linewidth=1.8, label=way)
        axes.set_xlim(left=0.0)
        axes.set_ylim(0.0, 102.0)
    style.legend(figure, axes.get_legend_handles_labels()[0], loc="lower center", ncols=3)
    count = max(len(there) for there in found.values())
    style.heading(figure, "Arbitrary goals", f"{count} of the right hand, half in front, half behind; the base floats")
    return style.save(figure, file)


def _matrix(quaternion: FloatArray) -> FloatArray:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quaternion, dtype=np.float64))
    return matrix.reshape(3, 3)
