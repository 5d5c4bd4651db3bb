"""Pictures of the robot from a bag."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np

from valor.analysis import style
from valor.analysis.bag import Bag
from valor.analysis.recording import Recording
from valor.bags.errors import BagError
from valor.common.topics import GROUND_TRUTH, MOTION_STATE, PROPRIOCEPTOR
from valor.drawing.posture import Posture
from valor.drawing.scene import Scene
from valor.robot.description import RobotDescription

PANEL = (760, 960)  # width, height [pixels]
_HEADER, _DPI = 96, 100  # [pixels], [pixels/inch]
_FARTHEST = 0.98  # of the largest joint displacement: the robot has arrived


def render_before_after(
    bag: Bag | Path, robot: RobotDescription, out: Path, times: tuple[float, float] | None = None
) -> list[Path]:
    """Draw the robot before it manipulates and when it is farthest from there, side by side.

    Args:
        bag: the recording.
        robot: whose it is.
        out: the folder for ``before_after.png``.
        times: robot times [s] of the two, if others are wanted.

    Returns:
        The file made.

    Raises:
        BagError: the bag is broken or lacks a topic; names it.
        RenderingError: there is no off-screen OpenGL here.
    """
    recording = Recording(Bag.of(bag), robot)
    recording.load(PROPRIOCEPTOR, MOTION_STATE)
    if recording.has(GROUND_TRUTH):
        recording.load(GROUND_TRUTH)
    before_time, after_time = times or _before_and_after(recording)
    before, after = recording.posture(before_time), recording.posture(after_time)
    width, height = PANEL
    with closing(Scene(robot, width, height, *recording.world)) as scene:
        look_at = (before.pelvis_position + after.pelvis_position) / 2.0
        scene.look_at(np.array([look_at[0], look_at[1], 0.90]))
        images = [scene.draw(before), scene.draw(after)]
    figure = style.figure(2 * width / _DPI, (height + _HEADER) / _DPI, _DPI)
    share = height / (height + _HEADER)
    for i, (image, label, posture) in enumerate(zip(images, ("before", "after"), (before, after), strict=True)):
        figure.figimage(image, xo=i * width, yo=0, origin="upper")  # pixel for pixel
        middle, top = (i + 0.5) / 2, share + (1.0 - share) * 0.66
        figure.text(middle, top, label, ha="center", va="center", fontsize=19, color=style.INK, weight="bold")
        text = _caption(posture, before, recording)
        figure.text(middle, top - (1.0 - share) * 0.38, text, ha="center", va="center", fontsize=12.5, color=style.GREY)
    figure.add_artist(style.line((0.5, 0.5), (0.0, 1.0), "white", 3.0))
    return [style.save(figure, out / "before_after.png", _DPI)]


def _before_and_after(recording: Recording) -> tuple[float, float]:
    """The last moment before the arms were free, and the last at which the robot was farthest from there [s]."""
    times, positions = recording.measured()
    span = recording.manipulation()
    if span is None:
        raise BagError(f"{recording.bag.path}: the robot was never in a manipulate behavior: no before and after")
    inside = np.flatnonzero((times >= span[0]) & (times <= span[1]))
    if not inside.size:
        raise BagError(f"{recording.bag.path}: no Proprioceptor while the arms were free")
    first = max(0, int(inside[0]) - 1)
    distance = np.linalg.norm(positions[inside] - positions[first], axis=1)
    arrived = inside[np.flatnonzero(distance >= _FARTHEST * distance.max())[-1]]
    return float(times[first]), float(times[arrived])


def _caption(posture: Posture, before: Posture, recording: Recording) -> str:
    parts = [posture.behavior.replace("_", " "), f"t = {posture.time:.1f} s"]
    moved = np.abs(posture.joint_position - before.joint_position)
    if posture is not before and moved.size:
        joint = recording.robot.joints[int(moved.argmax())]
        pelvis = 100.0 * float(np.linalg.norm(posture.pelvis_position - before.pelvis_position))
        parts.append(f"{joint} moved {moved.max():.2f} rad")
        parts.append(f"pelvis {pelvis:.1f} cm")
    return "   ·   ".join(parts)
