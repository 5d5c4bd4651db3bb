"""Pictures of the robot before and after a manipulation, from a bag."""

from contextlib import closing
from pathlib import Path

import numpy as np

from valor.analysis import style
from valor.analysis.reading.bag import Bag
from valor.analysis.reading.recording import Recording
from valor.bags.errors import BagError
from valor.common.topics import GROUND_TRUTH, MOTION_STATE, PROPRIOCEPTOR
from valor.drawing import Posture
from valor.drawing.scene import Scene
from valor.robot.description import RobotDescription

PANEL = (760, 960)  # width, height [pixels]
_HEADER, _DPI = 96, 100  # [pixels], [pixels/inch]
_FARTHEST = 0.98  # fraction of the largest joint displacement at which the robot has arrived


def render_before_after(bag: Bag | Path, robot: RobotDescription, out: Path) -> list[Path]:
    """Draw the robot before a manipulation and at its farthest posture, side by side, into ``before_after.png``.

    Raises BagError (the bag is damaged or lacks a topic) or RenderingError (no off-screen OpenGL).
    """
    recording = Recording(Bag.of(bag), robot)
    recording.load(PROPRIOCEPTOR, MOTION_STATE)
    if recording.has(GROUND_TRUTH):
        recording.load(GROUND_TRUTH)
    before_time, after_time = _before_and_after(recording)
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
    """Last time before manipulation, and last time at the largest distance from that posture [s]."""
    times, positions = recording.measured()
    span = recording.manipulation()
    if span is None:
        raise BagError(f"{recording.bag.path}: no manipulation behavior; expected one")
    inside = np.flatnonzero((times >= span[0]) & (times <= span[1]))
    if not inside.size:
        raise BagError(f"{recording.bag.path}: no Proprioceptor during manipulation")
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
