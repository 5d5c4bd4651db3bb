"""Actuator profiles side by side: standing, walking and pushes, in one process. A table for ``control.py``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from benchmarks import pushes, walks
from harness.closed_loop import ClosedLoop, load_robot
from valor.whole_body.walking.velocity_steps import VelocitySteps

SECONDS = 10.0  # of standing, and of walking
SPEED = 0.5  # [m/s]
TOWARDS = ("forward", "left")  # of the pushes; the others are alike


def table(name: str, profiles: Sequence[str], seeds: int) -> Iterator[str]:
    """Every figure over all seeds: DCM errors as root mean squares, impulses as the mean, or the least with steps."""
    columns = [figures(name, profile, seeds) for profile in profiles]
    yield f"\n## Actuator profiles, {name}\n"
    heads = [f"{seeds} seeds, DCM errors RMS in x, y, z", *(f"`{profile}`" for profile in profiles)]
    yield f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}"
    for row in columns[0]:
        yield f"| {row} | {' | '.join(column[row] for column in columns)} |"


def figures(name: str, profile: str, seeds: int) -> dict[str, str]:
    """A column: row → cell."""
    robot, rooted = load_robot(name), load_robot(name, disturbance={"step_when_standing": False})
    limits = pushes.bounds(rooted)
    found: dict[str, str] = {}
    for speed, what in ((0.0, f"standing {SECONDS:.0f} s"), (SPEED, f"walking {SECONDS:.0f} s at {SPEED} m/s")):
        runs = [run(walks.standing_in(robot, profile, seed, "flat"), speed) for seed in range(seeds)]
        good = [error for fall, error in runs if fall is None]
        rms = ", ".join(f"{1e3 * error:.1f}" for error in np.sqrt(np.mean(np.square(good), axis=0))) if good else "–"
        found[what] = f"{len(good)}/{seeds}; {rms} mm"
    fixed = [pushes.standing(rooted, profile, seed) for seed in range(seeds)]
    free = [pushes.standing(robot, profile, seed) for seed in range(seeds)]
    ways = {towards: pushes.DIRECTIONS[towards] for towards in TOWARDS}
    most = [np.mean([pushes.most_fixed(each, way, limits[to]) for each in fixed]) for to, way in ways.items()]
    least = [min(pushes.most_stepping(each, way)[0] for each in free) for way in ways.values()]
    found[f"push {', '.join(ways)}, feet fixed"] = f"{', '.join(f'{impulse:.1f}' for impulse in most)} N·s"
    found[f"push {', '.join(ways)}, stepping"] = f"{', '.join(f'{impulse:.0f}' for impulse in least)} N·s"
    return found


def run(loop: ClosedLoop, speed: float) -> tuple[str | None, np.ndarray]:
    """Stand or walk; how it fell, and the DCM's error, RMS (3,) [m]."""
    source = VelocitySteps(loop.robot.tables.walking)
    if speed:
        loop.request.steps = source
    until, errors = loop.time + SECONDS, []
    while loop.fall is None and loop.time < until:
        source.command(np.array((speed, 0.0, 0.0)), loop.time)
        source.advance(loop.time)
        loop.step()
        errors.append(loop.state.dcm_in_odom - loop.command.dcm_reference_in_odom)
    return loop.fall, np.sqrt(np.mean(np.square(errors), axis=0))
