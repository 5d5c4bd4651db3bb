"""A plan and what became of it, from above; steps that go up or down carry their height."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.errors import ValorError
from valor.common.poses import Pose, middle
from valor.robot.soles import outline
from valor.robot.tables import Feet

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIDES = ("left", "right")
_MARGIN = 0.35  # around the steps [m]
_ARROW = 0.3  # [m]
_ASIDE, _MEET = 0.03, 0.05  # of a number from its sole's edge; closer ones are told together [m]
LEVEL = 0.01  # a step not higher or lower than that is on the ground where the robot stood [m]


def draw(
    file: Path,
    feet: Feet,
    start: Sequence[Pose],
    steps: Sequence[tuple[int, Pose]],
    end: Sequence[Pose] | None,
) -> None:
    """Write the picture.

    Args:
        file: of a kind that matplotlib knows by its ending.
        feet: their outlines.
        start: left and right sole at the start, in odom.
        steps: foot and sole, in order, in odom.
        end: left and right sole at the end; None: not known.

    Raises:
        ValorError: the picture cannot be written.
    """
    from matplotlib.patches import Patch, Polygon

    from valor.analysis import style

    places = np.array([pose.position[:2] for pose in (*start, *(pose for _, pose in steps), *(end or ()))])
    across, along = np.ptp(places, axis=0)[::-1] + 2.0 * _MARGIN
    width, height = 8.0, float(np.clip(8.0 * across / along, 2.2, 9.0)) + 1.7
    figure = style.figure(width, height, 120)
    axes = figure.add_axes((0.09, 0.55 / height, 0.88, 1.0 - 1.75 / height))
    style.quiet(axes, "", "x in odom [m]", "y in odom [m]")
    ground, colors = sum(pose.position[2] for pose in start) / len(start), (style.LEFT, style.RIGHT)

    def sole(foot: int, pose: Pose, **look: Any) -> None:
        corners = outline(pose.position, pose.rotation, feet.left if foot == 0 else feet.right)
        axes.add_patch(Polygon(corners, closed=True, **look))

    for foot in (0, 1):
        sole(foot, start[foot], facecolor=style.LIGHT, edgecolor=style.GREY)
    for foot, pose in steps:
        sole(foot, pose, facecolor=colors[foot], edgecolor=colors[foot], alpha=0.35, linewidth=1.0)
    for (x, y), text in _numbers(steps, feet, ground):
        axes.annotate(text, (x, y), ha="center", va="center", fontsize=8, color=style.INK)
    for foot, pose in enumerate(end or ()):
        sole(foot, pose, fill=False, edgecolor=style.INK, linewidth=1.4)
    _heads(axes, start, style.GREY)
    _heads(axes, end or (), style.INK)
    axes.set_aspect("equal", anchor="W")
    axes.set_xlim(places[:, 0].min() - _MARGIN, places[:, 0].max() + _MARGIN)
    axes.set_ylim(places[:, 1].min() - _MARGIN, places[:, 1].max() + _MARGIN)
    style.heading(figure, f"{len(steps)} steps from above", "planned soles by number, what was reached; arrows: ahead")
    named = [Patch(facecolor=style.LIGHT, edgecolor=style.GREY, label="start")]
    named += [
        Patch(color=color, alpha=0.35, label=f"planned, {side}") for side, color in zip(SIDES, colors, strict=True)
    ]
    named += [Patch(fill=False, edgecolor=style.INK, linewidth=1.4, label="reached")] if end else []
    style.key(figure, named)
    try:
        figure.savefig(file)
    except (OSError, ValueError) as error:
        raise ValorError(f"{file}: the picture cannot be written: {error}") from None


def _numbers(steps: Sequence[tuple[int, Pose]], feet: Feet, ground: float) -> list[tuple[FloatArray, str]]:
    """Where, and what, beside each sole on the foot's own side, for the next may lie on it; one for those that meet."""
    found: list[tuple[FloatArray, str]] = []
    for number, (foot, pose) in enumerate(steps):
        size = feet.left if foot == 0 else feet.right
        side = (size.half_width + _ASIDE) * (1.0 if foot == 0 else -1.0)
        at = np.array((pose @ Pose(((size.heel + size.toe) / 2.0, side, 0.0))).position[:2])
        height = pose.position[2] - ground
        text = f"{number} ({height:+.2f} m)" if abs(height) > LEVEL else str(number)
        near = next((i for i, (place, _) in enumerate(found) if np.linalg.norm(place - at) < _MEET), None)
        if near is None:
            found.append((at, text))
        else:
            found[near] = (found[near][0], f"{found[near][1]}, {text}")
    return found


def _heads(axes: Axes, soles: Sequence[Pose], color: str) -> None:
    """An arrow from the middle of two soles to where the robot looks."""
    if len(soles) != len(SIDES):
        return
    centre = middle(*soles)
    x, y = centre.position[:2]
    tip = (x + _ARROW * math.cos(centre.yaw), y + _ARROW * math.sin(centre.yaw))
    axes.annotate("", tip, (x, y), arrowprops={"arrowstyle": "-|>", "color": color, "linewidth": 1.6})
