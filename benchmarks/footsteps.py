"""Which footsteps ESCHER walks, and how well: the example plans, and the limits of robot.yaml's table ``footsteps``.

Plant and controller in one process; every plan goes through the Motion Manager's own handler and queue. Prints Markdown
tables over seeds: how many runs came to rest on the plan's last steps without a fall and without an infeasible QP, how
far a foot came down from where it was asked to, and how far the feet stand from the plan in the end, as the robot
believes and in truth (which is odometry's drift as well).

    .venv/bin/python benchmarks/footsteps.py [plans] [limits] [--only NAME …] [--seeds 3] [--profile hardware]
        [--set max_forward=0.5 …]
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the services run; NumPy reads it once

from harness.closed_loop import load_robot
from valor.common.poses import level
from valor.robot.motion_tables import Footsteps
from valor.robot.step_plan import FEET, PlanStep, load
from valor.self_test.plan_walk import Walked, walk_plan
from valor.simulation import worlds
from valor.simulation.worlds.courses import Stairs

PLANS = Path(__file__).parents[1] / "examples" / "plans"
WORLD = {"stairs": "stairs"}  # of a plan; all others: flat
TREAD = 0.3  # of the stairs that steps up and down are tried on [m]
GOOD = (0.03, math.radians(3.0))  # no farther a foot may stand from the plan in the end [m, rad]

SLACK = {
    "max_forward": 0.03,
    "max_backward": 0.03,
    "min_width": -0.01,
    "max_width": 0.03,
    "max_distance": 0.03,
    "max_up": 0.02,
    "max_down": 0.02,
    "max_yaw": 0.03,
}  # [m, rad]


@dataclass(frozen=True)
class Move:
    """A step as seen from the other foot; a duration or a height of 0 is the robot's default."""

    forward: float = 0.0  # [m]
    width: float = 0.2  # [m]
    up: float = 0.0  # [m]
    turn: float = 0.0  # away from the standing foot [rad]
    swing_height: float = 0.0  # [m]
    swing: float = 0.0  # [s]
    transfer: float = 0.0  # [s]


Case = Callable[[Footsteps], list[Move]]


def _aside(limits: Footsteps, forward: float) -> float:
    """The greatest width of a step so far ahead or back [m]."""
    return min(limits.max_width, math.sqrt(limits.max_distance**2 - forward**2))


def _ahead(limits: Footsteps, width: float = 0.2) -> float:
    """The greatest length of a step so wide [m]."""
    return min(limits.max_forward, math.sqrt(limits.max_distance**2 - width**2))


def _corner(limits: Footsteps, forward: float, turn: float = 0.0) -> list[Move]:
    """As far as may be, and as wide as may be with that, with either foot, and together again."""
    far = Move(forward, _aside(limits, forward), turn=turn)
    return [far, Move(), Move(), far, Move(), Move()]


def _quick(moves: list[Move], limits: Footsteps) -> list[Move]:
    return [replace(m, swing=limits.min_swing_duration, transfer=limits.min_transfer_duration) for m in moves]


def _slow(moves: list[Move], limits: Footsteps) -> list[Move]:
    return [replace(m, swing=limits.max_swing_duration, transfer=limits.max_transfer_duration) for m in moves]


DIAGONAL = math.sqrt(0.5)  # of the greatest distance

CASES: dict[str, Case] = {
    "forward": lambda t: [Move(_ahead(t))] * 5,
    "forward, quick": lambda t: _quick([Move(_ahead(t))] * 5, t),
    "forward, slow": lambda t: _slow([Move(_ahead(t))] * 2, t),
    "forward, narrow": lambda t: [Move(_ahead(t, t.min_width), t.min_width)] * 5,
    "backward": lambda t: [Move(-t.max_backward)] * 5,
    "backward, quick": lambda t: _quick([Move(-t.max_backward)] * 5, t),
    "wide": lambda t: [Move(0.0, _aside(t, 0.0)), Move()] * 3,
    "wide, quick": lambda t: _quick([Move(0.0, _aside(t, 0.0)), Move()] * 3, t),
    "forward and wide": lambda t: _corner(t, DIAGONAL * t.max_distance),
    "forward and wide, quick": lambda t: _quick(_corner(t, DIAGONAL * t.max_distance), t),
    "forward and wide, out": lambda t: _corner(t, DIAGONAL * t.max_distance, t.max_yaw),
    "forward and wide, in": lambda t: _corner(t, DIAGONAL * t.max_distance, -t.max_yaw),
    "backward and wide": lambda t: _corner(t, -t.max_backward),
    "backward and wide, out": lambda t: _corner(t, -t.max_backward, t.max_yaw),
    "backward and wide, in": lambda t: _corner(t, -t.max_backward, -t.max_yaw),
    "turned out": lambda t: [Move(turn=t.max_yaw), Move()] * 3,
    "turned in": lambda t: [Move(0.0, 0.3, turn=-t.max_yaw), Move()] * 3,
    "high": lambda t: [Move(0.2, swing_height=t.max_swing_height)] * 4,
    "high, quick": lambda t: _quick([Move(0.2, swing_height=t.max_swing_height)] * 4, t),
    "long swing, short transfer": lambda t: (
        [Move(0.2, swing=t.max_swing_duration, transfer=t.min_transfer_duration)] * 3
    ),
    "quick": lambda t: _quick([Move(0.2)] * 6, t),
}
UP_AND_DOWN = "up and down"  # needs ground of its own


def steps_of(moves: Sequence[Move], first_foot: int = 0) -> list[PlanStep]:
    """A plan from the feet side by side, and the feet side by side at its end."""
    stance, steps = level(0.0, -0.1 if first_foot == 0 else 0.1, 0.0, 0.0), []
    for number, move in enumerate([*moves, Move()]):
        foot = (first_foot + number) % 2
        side = 1.0 if foot == 0 else -1.0
        stance = stance @ level(move.forward, side * move.width, move.up, side * move.turn)
        x, y, z = stance.position
        steps.append(
            PlanStep(
                foot=FEET[foot],
                x=x,
                y=y,
                z=z,
                yaw=stance.yaw,
                swing_height=move.swing_height,
                step_duration=move.swing,
                sway_duration=move.transfer,
            )
        )
    return steps


def up_and_down(up: float, down: float) -> tuple[str, list[PlanStep]]:
    """A step up onto a landing and down again; as high as the lower of both limits."""
    rise = min(up, down)
    worlds.WORLDS["step"] = Stairs(rise=rise, tread=TREAD, steps=1, landing=1.2)
    edge = worlds.WORLDS["step"].up[0]  # type: ignore[attr-defined]
    places = [(0.3, 0.0), (edge + 0.13, rise), (edge + 0.5, rise), (edge + 0.9, rise), (edge + 1.2 + 0.13, 0.0)]
    steps = []
    for x, z in places:
        steps += [PlanStep(foot="left", x=x, y=0.1, z=z), PlanStep(foot="right", x=x, y=-0.1, z=z)]
    return "step", steps


def good(walked: Walked) -> bool:
    """Return whether a plan was walked as asked."""
    far, turned = walked.believed
    return walked.done and far <= GOOD[0] and turned <= GOOD[1]


def row(name: str, runs: Sequence[Walked]) -> str:
    """A line of a table."""
    taken = [run for run in runs if run.done]
    cells = [name, f"{sum(map(good, runs))}/{len(runs)}"]
    if taken:
        cells.append(f"{max(run.duration for run in taken):.1f}")
        for errors in ([r.landing for r in taken], [r.believed for r in taken], [r.true for r in taken]):
            far, turned = max(e[0] for e in errors), max(e[1] for e in errors)
            cells.append(f"{far * 100:.1f}, {math.degrees(turned):.1f}")
        cells.append(f"{min(run.knee for run in taken):.2f}")
    why = {run.refusal or run.fall or (f"{run.qp_failures} infeasible" if run.qp_failures else "") for run in runs}
    return f"| {' | '.join(cells)} | {'; '.join(sorted(why - {''}))} |"


HEADER = (
    "| {} | walked | duration [s] | landing [cm, °] | end, believed [cm, °] | end, true [cm, °] | knee [rad] | |\n"
    "|---|---|---|---|---|---|---|---|"
)


def main() -> None:
    """Run what the command line asks for; both tables by default."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", default=["plans", "limits"], help="plans, limits; default: both")
    parser.add_argument("--only", nargs="+", default=[], help="rows, by name")
    parser.add_argument("--robot", default="escher")
    parser.add_argument("--profile", default="hardware")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--set", nargs="+", default=[], help="limits other than robot.yaml's: max_forward=0.5")
    arguments = parser.parse_args()
    changes = {name: float(value) for name, value in (each.split("=") for each in arguments.set)}
    limits = load_robot(arguments.robot, footsteps=changes).tables.footsteps
    if limits is None:
        sys.exit(f"robot {arguments.robot!r} takes no footstep plans: its robot.yaml has no footsteps")
    # The feet stand a little beside where a plan at the very limit believes them.
    slack = {name: getattr(limits, name) + extra for name, extra in SLACK.items()}
    robot = load_robot(arguments.robot, footsteps=changes | slack)

    def run(name: str, steps: Sequence[PlanStep], world: str) -> None:
        if arguments.only and name not in arguments.only:
            return
        seeds = range(arguments.seeds)
        runs = [walk_plan(robot, steps, world=world, profile=arguments.profile, seed=seed) for seed in seeds]
        print(row(name, runs), flush=True)

    if "plans" in arguments.what:
        print(HEADER.format("plan"))
        for file in sorted(PLANS.glob("*.yaml")):
            run(file.stem, load(file).steps, WORLD.get(file.stem, "flat"))
    if "limits" in arguments.what:
        print(HEADER.format("limits"))
        for name, case in CASES.items():
            run(name, steps_of(case(limits)), "flat")
        world, steps = up_and_down(limits.max_up, limits.max_down)
        run(UP_AND_DOWN, steps, world)


if __name__ == "__main__":
    main()
