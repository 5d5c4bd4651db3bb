"""Pushes of 0.1 s at the chest: feet fixed, stepping allowed, walking. Tables for ``control.py``.

Every push begins from a fork of one process that stands or walks: what comes before it is simulated once. As a
command it prints and draws the largest push in every direction that a robot survives, and continues an existing JSON
file (``--help``):

    .venv/bin/python -m benchmarks.pushes --json build/pushes.json --picture docs/pictures/push_rose.png
"""

from __future__ import annotations

import argparse
import json
import os
import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the services run; NumPy reads it once

import numpy as np

from harness.closed_loop import ClosedLoop, load_robot
from valor.analysis import style
from valor.control.kinematics import UpperBodyKinematics, natural_frequency
from valor.robot.description import RobotDescription
from valor.robot.legs import knees
from valor.robot.model import controller_model
from valor.robot.size import ESCHER
from valor.whole_body.walking.velocity_steps import VelocitySteps

DIRECTIONS = {"forward": (1, 0), "back": (-1, 0), "left": (0, 1), "right": (0, -1)}
DURATION = 0.1  # [s]
RESOLUTION = 0.8  # of the bisection with fixed feet [N·s]
LADDER = tuple(np.arange(30.0, 121.0, 5.0).tolist())  # with steps, until it falls [N·s]
RUNG = 2.5  # of the ladder for the rose, from the same first one [N·s]
AT_REST = 0.01  # DCM error of a robot that has got over it [m] …
SETTLED = 1.5  # … so long after the push, at the earliest [s]
SPEED = 0.3  # of the walk [m/s]
PHASES = 16  # of two steps
IMPULSES = (15.0, 25.0)  # while walking [N·s]
REACHED = 12.0  # time when it has walked onto ground that is not flat [s]
AGAIN = 0.7  # between two pushes [s]
T = TypeVar("T")
P = ParamSpec("P")


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a push."""

    fall: str | None
    time: float  # until then, or until the end [s]
    steps: int
    dcm_error: float  # RMS in the plane [m]
    knee: float  # smallest angle [rad]
    saturated: int  # joint torques at their limit, in joint-ticks
    failures: int  # of the QP

    @property
    def survived(self) -> bool:
        """True if the robot did not fall."""
        return self.fall is None


@dataclass(frozen=True, slots=True)
class Kind:
    """Motion of the robot, and place and number of its pushes."""

    walk: VelocitySteps | None = None  # None: it stands
    body: str = ""  # pushed; empty: the chest
    again: float = np.inf  # time of a second push [s]


def forked(function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """What ``function`` returns, computed in a copy of this process: whatever it changes stays there."""
    source, sink = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(source)
        with os.fdopen(sink, "wb") as pipe:
            pickle.dump(function(*args, **kwargs), pipe)
            pipe.flush()
            os._exit(0)
    os.close(sink)
    with os.fdopen(source, "rb") as pipe:
        data = pipe.read()
    os.waitpid(child, 0)
    result: T = pickle.loads(data)  # from ourselves
    return result


def push(
    loop: ClosedLoop, direction: tuple[float, float], impulse: float, seconds: float, kind: Kind = Kind()
) -> Outcome:
    """Push the robot [N·s] and go on until it falls, stands at rest, or for so long; walking on if it walks."""
    began, swinging, steps, saturated = loop.time, None, 0, 0
    bent = knees(loop.robot)
    knee, errors = np.inf, []
    failures = loop.command.qp_failures
    pushes = [began + kind.again, began]
    while loop.fall is None and loop.time < began + seconds:
        while pushes and loop.time >= pushes[-1]:
            loop.plant.push(impulse * np.array((*direction, 0.0)), DURATION, kind.body)
            began = pushes.pop()
        if kind.walk is not None:
            go(loop, kind.walk)
        loop.step()
        steps += loop.controller.swinging is not None and loop.controller.swinging != swinging
        swinging = loop.controller.swinging
        errors.append((loop.state.dcm_in_odom - loop.command.dcm_reference_in_odom)[:2])
        if loop.controller.at_rest and loop.time > began + SETTLED and np.hypot(*errors[-1]) < AT_REST:
            break
        knee = min(knee, float(bent.flexion(loop.plant.joint_position).min()))
        saturated += int(np.count_nonzero(np.abs(loop.command.effort) >= 0.999 * loop.robot.effort_limit))
    rms = float(np.sqrt(np.mean(np.sum(np.square(errors), axis=1))))
    return Outcome(loop.fall, loop.time - began, steps, rms, knee, saturated, loop.command.qp_failures - failures)


def go(loop: ClosedLoop, walk: VelocitySteps, speed: float = SPEED) -> None:
    """Ask for the walk's speed once more [m/s]."""
    walk.command(np.array((speed, 0.0, 0.0)), loop.time)
    walk.advance(loop.time)


def standing(robot: RobotDescription, profile: str, seed: int, hands: float = 0.0, world: str = "flat") -> ClosedLoop:
    """A robot that stands on the ground of a world; with more in each hand than the controller knows [kg]."""
    loop = ClosedLoop(robot, profile, seed, world)
    for hand in (robot.tables.hands.left, robot.tables.hands.right) if hands else ():
        assert hand is not None
        loop.plant.model.mj.body_mass[loop.plant.model.body(hand.body)] += hands
    loop.settle(0.3)
    loop.run(2.2)
    if world != "flat":  # other ground begins ahead
        walk = loop.request.steps = VelocitySteps(robot.tables.walking)
        while loop.time < REACHED or not loop.controller.at_rest:
            go(loop, walk, SPEED if loop.time < REACHED else 0.0)
            loop.step()
        loop.request.steps = None
        loop.run(2.2)
    return loop


def bounds(robot: RobotDescription) -> dict[str, float]:
    """m·ω·Δξ for each direction [N·s]: what a point mass with its CoP at the sole's edge survives at most."""
    model = controller_model(robot)
    mass = float(model.mj.body_subtreemass[model.body(robot.tables.base)])
    omega = natural_frequency(UpperBodyKinematics(model).nominal_com_height, 9.81)
    foot = robot.tables.feet.left
    loop = ClosedLoop(robot)
    loop.step()
    apart = float(loop.state.sole_positions_in_odom[0, 1] - loop.state.sole_positions_in_odom[1, 1])
    half = (0.5 * (foot.toe - foot.heel), 0.5 * apart + foot.half_width)
    return {name: mass * omega * float(abs(np.dot(direction, half))) for name, direction in DIRECTIONS.items()}


def most_fixed(loop: ClosedLoop, direction: tuple[int, int], bound: float) -> float:
    """The largest push that a robot without steps survives, by bisection below a bound and a tenth more [N·s]."""
    low, high = 0.5 * bound, 1.1 * bound
    while high - low > RESOLUTION:
        middle = 0.5 * (low + high)
        better = forked(push, loop, direction, middle, 4.0).survived
        low, high = (middle, high) if better else (low, middle)
    return low


def most_stepping(
    loop: ClosedLoop, direction: tuple[float, float], ladder: Sequence[float] = LADDER, kind: Kind = Kind()
) -> tuple[float, Outcome | None, Outcome | None]:
    """The largest push of a ladder below the first fall [N·s], its outcome, and that of the last push."""
    best, most, last = None, 0.0, None
    for impulse in ladder:
        last = forked(push, loop, direction, impulse, 3.0 if kind.walk else 6.0, kind)
        if not last.survived:
            break
        best, most = last, impulse
    return most, best, last


def fixed(name: str, profile: str, seeds: int) -> Iterator[str]:
    """The largest push survived without a step, by bisection, and when one of 80 N·s is told to be a fall."""
    robot = load_robot(name, disturbance={"step_when_standing": False})
    limits = bounds(robot)
    loops = [standing(robot, profile, seed) for seed in range(seeds)]
    yield f"\n## Pushes of {DURATION} s at the chest, feet fixed, {profile}\n"
    yield "| direction | survived, by seed [N·s] | bound m·ω·Δξ [N·s] | share | 80 N·s told after [ms] |"
    yield "|---|---|---|---|---|"
    for towards, direction in DIRECTIONS.items():
        survived, told = [], []
        for loop in loops:
            survived.append(most_fixed(loop, direction, limits[towards]))
            told.append(forked(push, loop, direction, 80.0, 4.0).time)
        impulses, times = ", ".join(f"{s:.1f}" for s in survived), ", ".join(f"{1e3 * t:.0f}" for t in told)
        bound = limits[towards]
        yield f"| {towards} | {impulses} | {bound:.1f} | {100 * np.mean(survived) / bound:.0f} % | {times} |"


def stepping(name: str, profile: str, seeds: int) -> Iterator[str]:
    """The largest push survived by stepping, up a grid, and how it went."""
    loops = [standing(load_robot(name), profile, seed) for seed in range(seeds)]
    yield f"\n## Pushes of {DURATION} s at the chest, stepping allowed, up by 5 N·s until it falls, {profile}\n"
    yield f"| direction | seed | survived [N·s] | {FIGURES} | then |"
    yield "|---|---|---|---|---|---|---|---|---|"
    for towards, direction in DIRECTIONS.items():
        for seed, loop in enumerate(loops):
            most, best, last = most_stepping(loop, direction)
            yield f"| {towards} | {seed} | {most:.0f} | {figures(best)} | {last.fall if last and last.fall else '–'} |"


def walking(name: str, profile: str, seeds: int) -> Iterator[str]:
    """Pushes at any phase of two steps, the direction another one with each."""
    yield f"\n## Pushes of {DURATION} s at the chest, walking at {SPEED} m/s, {PHASES} phases, {profile}\n"
    yield f"| impulse [N·s] | seed | survived | {FIGURES} | fell when pushed (phase) |"
    yield "|---|---|---|---|---|---|---|---|---|"
    for seed in range(seeds):
        outcomes: dict[float, list[tuple[str, Outcome]]] = {impulse: [] for impulse in IMPULSES}
        loop = standing(load_robot(name), profile, seed)
        walk = loop.request.steps = VelocitySteps(loop.robot.tables.walking)
        directions = list(DIRECTIONS.items())
        for phase in strides(loop, walk, PHASES):
            towards, direction = directions[phase % len(directions)]
            for impulse, results in outcomes.items():
                outcome = forked(push, loop, direction, impulse, 3.0, Kind(walk))
                results.append((f"{towards} ({phase / PHASES:.2f})", outcome))
        for impulse, results in outcomes.items():
            good = [outcome for _, outcome in results if outcome.survived]
            fell = "; ".join(when for when, outcome in results if not outcome.survived)
            worst = Outcome(
                None, 3.0, max(o.steps for o in good), max(o.dcm_error for o in good), min(o.knee for o in good),
                max(o.saturated for o in good), max(o.failures for o in good),
            ) if good else None  # fmt: skip
            yield f"| {impulse:.0f} | {seed} | {len(good)} of {PHASES} | {figures(worst)} | {fell or '–'} |"


def strides(loop: ClosedLoop, walk: VelocitySteps, phases: int) -> Iterator[int]:
    """Walk, and stop at so many phases of two steps at full speed."""
    period, began, phase = 2.0 * sum(walk.durations(np.array((SPEED, 0.0, 0.0)))), np.inf, 0
    swinging: int | None = 0
    while phase < phases and loop.fall is None:
        go(loop, walk)
        loop.step()
        if loop.controller.swinging == 0 and swinging != 0 and loop.time > 7.0 and np.isinf(began):
            began = loop.time  # the left foot leaves the ground
        swinging = loop.controller.swinging
        if loop.time >= began + (phase + 0.5) / phases * period:
            yield phase
            phase += 1


def rose(results: Mapping[str, Mapping[str, Sequence[float]]], robot: str, picture: Path) -> None:
    """Draw the largest push of the worst seed by direction, forward up [N·s/kg]; the last result is today's."""
    drawn = style.figure(5.2, 5.4)
    axes: Any = drawn.add_subplot(projection="polar")
    axes.set_theta_zero_location("N")
    for i, (name, headings) in enumerate(results.items()):
        angles = sorted(map(float, headings))
        least = [min(headings[f"{angle:g}"]) for angle in angles]
        last = i == len(results) - 1
        color, dashes = (style.MEASURED, "-") if last else (style.GREY, style.DASHES)
        axes.plot(np.radians([*angles, angles[0]]), [*least, least[0]], color=color, linestyle=dashes, label=name)
    axes.set_ylim(0.0)
    axes.tick_params(colors=style.GREY, labelsize=8.5)
    axes.set_title(f"{robot}: largest push survived [N·s/kg]", fontsize=10, color=style.INK)
    if len(results) > 1:
        axes.legend(loc="lower left", bbox_to_anchor=(-0.1, -0.1), fontsize=8.5, frameon=False)
    drawn.savefig(picture)


def starts(robot: RobotDescription, options: argparse.Namespace) -> Iterator[tuple[ClosedLoop, VelocitySteps | None]]:
    """The robot by seed, as it stands, or at phases of its walk; each is valid until the next."""
    for seed in range(options.seeds):
        loop = standing(robot, options.profile, seed, options.hands, options.world)
        if not options.walking:
            yield loop, None
            continue
        walk = loop.request.steps = VelocitySteps(robot.tables.walking)
        for _ in strides(loop, walk, options.walking):
            yield loop, walk


def main() -> None:
    """Run what the command line asks for."""
    options = asked()
    robot = load_robot(options.robot)
    mass, name = robot.tables.size.mass, robot.tables.name
    first = IMPULSES[0] if options.walking else LADDER[0]
    ladder = (mass / ESCHER.mass * np.arange(first, LADDER[-1], options.step)).tolist()
    arm = robot.joints[robot.group_indices("left_arm")[0]]
    found: dict[str, list[float]] = json.loads(options.json.read_text()) if options.json.exists() else {}
    headings = [f"{360.0 * k / options.directions:g}" for k in range(options.directions)]
    for count, (loop, walk) in enumerate(starts(robot, options), 1):
        mj = loop.plant.model.mj
        bodies = {"chest": "", "pelvis": robot.tables.base, "shoulder": mj.body(mj.joint(arm).bodyid[0]).name}
        kind = Kind(walk, bodies[options.at], AGAIN if options.twice else np.inf)
        for heading in headings:
            done = found.setdefault(heading, [])
            if len(done) < count:
                angle = np.radians(float(heading))
                done.append(most_stepping(loop, (np.cos(angle), np.sin(angle)), ladder, kind)[0] / mass)
                options.json.write_text(json.dumps(found))
    print("| heading [°] | survived, by seed and phase [N·s] | least [N·s/kg] |\n|---|---|---|")
    for heading in headings:
        done = found[heading]
        print(f"| {heading} | {', '.join(f'{mass * j:.1f}' for j in done)} | {min(done):.2f} |")
    if options.picture is not None:
        before = {"before": json.loads(options.before.read_text())} if options.before else {}
        rose({**before, "now": found}, name.upper(), options.picture)


def asked() -> argparse.Namespace:
    """Options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="escher", help="name, or absolute path of a folder")
    parser.add_argument("--profile", default="hardware")
    parser.add_argument("--world", default="flat", help="ground, by its name for `valorctl up --world`")
    parser.add_argument("--directions", type=int, default=16)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--step", type=float, default=RUNG, help="between rungs, for a mass of 75.9 kg [N·s]")
    parser.add_argument("--walking", type=int, default=0, metavar="PHASES", help=f"walk at {SPEED} m/s, so many phases")
    parser.add_argument("--at", choices=("chest", "pelvis", "shoulder"), default="chest", help="the left shoulder")
    parser.add_argument("--hands", type=float, default=0.0, help="carried in each hand, unknown to the controller [kg]")
    parser.add_argument("--twice", action="store_true", help=f"push again after {AGAIN} s")
    parser.add_argument("--json", type=Path, required=True, help="results by heading, 0 forward, 90 left [N·s/kg]")
    parser.add_argument("--before", type=Path, help="other results, to be drawn as well")
    parser.add_argument("--picture", type=Path)
    return parser.parse_args()


FIGURES = "steps | DCM error RMS [mm] | smallest knee angle [rad] | torques at their limit | QP failures"


def figures(outcome: Outcome | None) -> str:
    """As the cells of ``FIGURES``."""
    if outcome is None:
        return "– | – | – | – | –"
    return (
        f"{outcome.steps} | {1e3 * outcome.dcm_error:.0f} | {outcome.knee:.2f} | {outcome.saturated} "
        f"| {outcome.failures}"
    )


if __name__ == "__main__":
    main()
