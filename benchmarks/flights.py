"""The footstep plan over a flight of stairs, up and down again, that walks in process and live ones take alike."""

from __future__ import annotations

from typing import Literal

from valor.robot.step_plan import PlanStep
from valor.robot.tables import RobotTables
from valor.simulation.worlds.stairs import Stairs

SWING_HEIGHT = 0.08  # between steps of stairs [m]
STEP_DURATION, SWAY_DURATION = 1.0, 0.4  # there [s]
LENGTH = 0.3  # of steps on the landing, about [m]
DOWN = 0.03  # further than the middle of a tread, so that the heel clears the edge [m]
BEFORE, RUN_UP = 0.03, 0.16  # of the toes to the first riser, and the step before it [m]


def over_stairs(tables: RobotTables, stairs: Stairs) -> list[PlanStep]:
    """One foot on each step, in its middle, going down a little further; feet together at the end. In odom."""
    table, foot = tables.walking, tables.feet.left
    middle = 0.5 * stairs.tread - 0.5 * (foot.heel + foot.toe)
    top = stairs.rise * stairs.steps
    first, last = stairs.up[-1] + middle, stairs.down[0] - foot.toe - 0.025  # on the landing
    level = max(2, round((last - first) / LENGTH))
    places = [(stairs.up[0] - foot.toe - BEFORE - x, 0.0) for x in (RUN_UP, 0.0)]
    places += [(x + middle, stairs.rise * (i + 1)) for i, x in enumerate(stairs.up)]
    places += [(first + (last - first) * (i + 1) / level, top) for i in range(level)]
    places += [(x + middle + DOWN, top - stairs.rise * (i + 1)) for i, x in enumerate(stairs.down)]
    places.append(places[-1])
    steps, height = [], 0.0
    for i, (x, z) in enumerate(places):
        slow = abs(z - height) > 0.0 or i == len(places) - 1
        lift, swing, sway = (SWING_HEIGHT, STEP_DURATION, SWAY_DURATION) if slow else (0.0, 0.0, 0.0)
        y = table.step_width * (0.5 - i % 2)
        side: Literal["left", "right"] = "right" if i % 2 else "left"
        steps.append(PlanStep(foot=side, x=x, y=y, z=z, swing_height=lift, step_duration=swing, sway_duration=sway))
        height = z
    return steps
