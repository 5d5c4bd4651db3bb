"""What becomes of a robot whose Motion Manager dies while it walks: its joints held at once, or the balance reflex.

In one process, without sockets. The robot walks; at phases spread evenly over the row's time its Motors stop. From each
the world goes on for some periods with the last Motor, then as the candidate would have it; then the robot is put back
and walks on to the next phase. It has fallen when its pelvis is 0.2 m lower than it was.

``python -m benchmarks.killed_walking [--rows walk aside …] [--profiles …] [--seeds …] [--phases N] [--blind N …]``
prints a table.
"""

from __future__ import annotations

import argparse
import logging
from dataclasses import dataclass

import numpy as np

from harness.closed_loop import load_robot
from harness.walking_robot import End, Then, WalkingRobot

Velocity = tuple[float, float, float]  # forward, left [m/s], turning [rad/s]
AHEAD: Velocity = (0.3, 0.0, 0.0)
REST: Velocity = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Row:
    """When it is killed."""

    note: str
    before: Velocity
    before_for: float  # [s]
    velocity: Velocity
    time: float  # over which the phases are spread [s]


# fmt: off
ROWS = {
    "begin": Row("0.3 m/s, from rest",         AHEAD,           0.0, AHEAD, 2.6),
    "walk":  Row("0.3 m/s",                    AHEAD,           4.0, AHEAD, 2.6),
    "end":   Row("0.3 m/s, then to rest",      AHEAD,           4.0, REST,  3.0),
    "slow":  Row("0.1 m/s",                    (0.1, 0.0, 0.0), 4.0, (0.1, 0.0, 0.0), 3.0),
    "fast":  Row("0.5 m/s",                    (0.5, 0.0, 0.0), 5.0, (0.5, 0.0, 0.0), 2.2),
    "aside": Row("0.1 m/s to the left",        (0.0, 0.1, 0.0), 4.0, (0.0, 0.1, 0.0), 3.0),
    "turn":  Row("turning on the spot, 0.3 rad/s", (0.0, 0.0, 0.3), 4.0, (0.0, 0.0, 0.3), 3.0),
}
# fmt: on


def measure(walking: WalkingRobot, row: Row, *, seed: int, phases: int, blind: int) -> list[list[End]]:
    """Of each phase what becomes of it with each of ``Then``; the seed says when the first one is."""
    walking.walk(row.before, row.before_for + np.random.default_rng(seed).uniform(0.0, row.time / phases))
    ends = []
    for _ in range(phases):
        ends.append([walking.abandon(then, blind) for then in Then])
        walking.walk(row.velocity, row.time / phases)
    return ends


def show(ends: list[list[End]], then: Then) -> str:
    """Falls, and of those that stand how they fared."""
    each = [phase[list(Then).index(then)] for phase in ends]
    text = f"{sum(end.fell for end in each)} of {len(each)}"
    stood = [end for end in each if not end.fell]
    if then is Then.HOLD or not stood:
        return f"{text} |"
    median, most = (np.percentile([end.time for end in stood], share) for share in (50, 100))
    peak, way = max(end.peak for end in stood), max(end.way for end in stood)
    return f"{text} | {median:.1f}, {most:.1f} | {100.0 * peak:.0f} | {100.0 * way:.0f} |"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", nargs="+", choices=list(ROWS), default=list(ROWS))
    parser.add_argument("--profiles", nargs="+", default=["ideal", "hardware"])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--phases", type=int, default=20, help="of each row and seed")
    parser.add_argument("--blind", type=int, nargs="+", default=[2], help="periods that go by with the last Motor")
    arguments = parser.parse_args()
    logging.disable(logging.WARNING)
    robot = load_robot()
    print(
        "| walking | profile | blind [ms] | held: fallen | reflex: fallen "
        "| stands after, median, most [s] | DCM off, most [cm] | pelvis moves, most [cm] |\n" + "|---" * 8 + "|"
    )
    for name in arguments.rows:
        for profile in arguments.profiles:
            for blind in arguments.blind:
                ends = [
                    end
                    for seed in arguments.seeds
                    for end in measure(
                        WalkingRobot(robot, profile, seed),
                        ROWS[name],
                        seed=seed,
                        phases=arguments.phases,
                        blind=blind,
                    )
                ]
                late = 1e3 * blind * robot.control_period
                held, reflex = (show(ends, then) for then in Then)
                print(f"| {ROWS[name].note} | {profile} | {late:.0f} | {held} {reflex}", flush=True)


if __name__ == "__main__":
    main()
