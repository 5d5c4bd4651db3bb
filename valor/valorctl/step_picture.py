"""A plan and what became of it, from above; steps that go up or down carry their height."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from valor.common.errors import ValorError
from valor.common.poses import Pose
from valor.robot.soles import outline
from valor.robot.tables import Feet

COLORS = ("tab:red", "tab:green")  # left, right, as on ships
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
    from matplotlib.figure import Figure
    from matplotlib.patches import Polygon

    figure = Figure(figsize=(8, 8), layout="constrained")
    axes = figure.add_subplot()
    ground = sum(pose.position[2] for pose in start) / len(start)

    def sole(foot: int, pose: Pose, **style: Any) -> None:
        corners = outline(pose.position, pose.rotation, feet.left if foot == 0 else feet.right)
        axes.add_patch(Polygon(corners, closed=True, **style))

    for foot in (0, 1):
        sole(foot, start[foot], facecolor="0.9", edgecolor="0.6", label="start" if foot == 0 else None)
    for number, (foot, pose) in enumerate(steps):
        first = number == next((i for i, (other, _) in enumerate(steps) if other == foot), -1)
        name = f"planned, {('left', 'right')[foot]}" if first else None
        sole(foot, pose, facecolor=COLORS[foot], edgecolor=COLORS[foot], alpha=0.35, label=name)
        height = pose.position[2] - ground
        label = f"{number}\n{height:+.2f} m" if abs(height) > LEVEL else str(number)
        axes.annotate(label, pose.position[:2], ha="center", va="center", fontsize=8)
    for foot in (0, 1) if end is not None else ():
        assert end is not None
        sole(foot, end[foot], fill=False, edgecolor="black", linewidth=1.5, label="reached" if foot == 0 else None)
    axes.autoscale_view()
    axes.margins(0.05)
    axes.set_aspect("equal")
    axes.set_xlabel("x in odom [m]")
    axes.set_ylabel("y in odom [m]")
    axes.grid(alpha=0.3)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.01), ncols=4, fontsize=8)
    try:
        figure.savefig(file, dpi=120, bbox_inches="tight")
    except (OSError, ValueError) as error:
        raise ValorError(f"{file}: the picture cannot be written: {error}") from None
