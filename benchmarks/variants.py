"""Whether a robot does on its devices what it does in simulation, and how well: every robot, both variants, seeds.

Each run is a system of its own (``valorctl up``). What is done is the table ``TRIALS`` of ``trials.py``; a figure
beyond what it may be at most is marked with `!`. Both variants run in real time, simulation in lockstep.

    .venv/bin/python benchmarks/variants.py [--robot escher thor] [--variants sim hardware] [--seeds 0 1 2]
        [--trials stand walk …] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from mcap.reader import make_reader

from benchmarks.live_system import running
from benchmarks.trials import TRIALS, Bench, Values, told
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.topics import DEVICES, JOINT_SETPOINTS, TOPICS
from valor.robot.description import RobotDescription
from valor.valorctl.profile import Profile

VARIANTS = ("sim", "hardware")
LOST = ("fall", "freeze", "soft_stop", "idle")  # behaviors from which no trial goes on
ROS_TOPICS = ("/joint_states", "/odom", "/imu/data", "/tf", "/tf_static", "/robot_description", "/diagnostics",
              "/flor/controller/mode")  # fmt: skip
MOST = {  # that a figure may be
    "up [s]": 60.0, "stand: pelvis strays [mm]": 5.0, "plan: sole off, in truth [cm]": 3.0,
    "plan: sole turned, in truth [°]": 3.0, "left arm: joint error [mrad]": 20.0, "right arm: joint error [mrad]": 20.0,
    "left hand: joint error [mrad]": 50.0, "right hand: joint error [mrad]": 50.0, "neck: joint error [mrad]": 20.0,
    "lidar_roll: speed off [%]": 5.0, "status: not ready, or restarted": 0.0,
    "/diagnostics: units missing or not well": 0.0, "bag: received, not written": 0.0, "bag: dropped": 0.0,
    "bag: topics missing": 0.0,
}  # fmt: skip


@dataclass
class Run:
    """What one run gave.

    Attributes:
        figures: by name; missing: it did not come to that.
        troubles: what went wrong, for people.
    """

    robot: str
    variant: str
    seed: int
    figures: dict[str, float] = field(default_factory=dict)
    troubles: list[str] = field(default_factory=list)
    load: float = 0.0  # of the machine, at the end


def recorded(bag: Path, expected: set[str]) -> Values:
    """Whether the bag holds everything that came, and everything that there is."""
    with open(bag, "rb") as stream:
        metadata = {each.name: each.metadata for each in make_reader(stream).iter_metadata()}
    counts = {topic: json.loads(count) for topic, count in metadata.get("topics", {}).items()}
    yield "bag: received", sum(each["received"] for each in counts.values())
    yield "bag: received, not written", sum(each["received"] - each["written"] for each in counts.values())
    yield "bag: dropped", sum(each["dropped"] for each in counts.values())
    absent = sorted(topic for topic in expected if not counts.get(topic, {}).get("written"))
    yield "bag: topics missing", len(absent)
    lost = [
        f"{topic}: {each['dropped']} of {each['received']} lost" for topic, each in counts.items() if each["dropped"]
    ]
    if absent or lost:
        raise ValorError("; ".join([f"not in the bag: {topic}" for topic in absent] + lost))


def expected_topics(profile: str, robot: RobotDescription) -> set[str]:
    """What a bag of a run of all trials must hold."""
    processes = {each.name for each in Profile.load(Path(__file__).parents[1] / "deploy" / f"{profile}.yaml")
                 .suiting(robot).table}  # fmt: skip
    always = {each.name for each in TOPICS if each.owner in processes and each.rate is not None}
    kept = {each.name for each in TOPICS if each.record_every}
    ours = always & kept | {JOINT_SETPOINTS.name} | ({DEVICES.name} if profile == "hardware" else set())
    return {f"/bifrost/{name}" for name in ours} | set(ROS_TOPICS)


def measure(home: Path, run: Run, trials: Sequence[str]) -> None:
    """One run: up, every trial until the robot falls, down, and a look into the bag.

    Raises:
        ValorError: it does not start.
    """
    bag = home / "run.mcap"
    options: dict[str, object] = {"profile": run.variant, "robot": run.robot, "seed": run.seed, "bag": bag}
    options |= {"actuators": "hardware"}

    def note(values: Values) -> None:
        try:
            for name, value in values:
                run.figures[name] = float(value)
        except ValorError as error:
            run.troubles.append(str(error))

    with running(Instance(f"variants-{run.seed}", home), options, lambda _: None) as system:
        run.figures["up [s]"] = system.up
        robot = RobotDescription.load(system.instance.settings().robot)
        bench = Bench(system, run.variant, robot)
        for name in trials:
            before = len(run.troubles)
            note(TRIALS[name](bench))
            what = f"  {run.robot}, {run.variant}, seed {run.seed}: {name}"
            print(what, *run.troubles[before:], sep="; ", file=sys.stderr, flush=True)
            state = system.observer.state
            if state.behavior in LOST:
                run.troubles.append(f"{state.behavior}: {state.reason}")
                note(told(bench))
                break
    note(recorded(bag, expected_topics(run.variant, robot)))
    bag.unlink()
    run.load = os.getloadavg()[0]


def tables(runs: Sequence[Run]) -> Iterator[str]:
    """One line a figure, one column a robot and variant, one number a seed."""
    columns = list(dict.fromkeys((run.robot, run.variant) for run in runs))
    yield "| | at most | " + " | ".join(f"{robot}, {variant}" for robot, variant in columns) + " |"
    yield "|---" * (len(columns) + 2) + "|"
    for name in dict.fromkeys(name for run in runs for name in run.figures):
        cells = []
        for column in columns:
            values = [run.figures.get(name) for run in runs if (run.robot, run.variant) == column]
            cells.append(
                ", ".join(_cell(name, value) for value in values) if any(v is not None for v in values) else ""
            )
        yield f"| {name} | {MOST.get(name, '')} | {' | '.join(cells)} |"
    for run in runs:
        if run.troubles:
            yield f"\n{run.robot}, {run.variant}, seed {run.seed}: {'; '.join(run.troubles)}"
    yield f"\nload of the machine: {', '.join(f'{run.load:.1f}' for run in runs)}"


def _cell(name: str, value: float | None) -> str:
    if value is None:
        return "–"
    return (f"{value:.3g}" if value < 1000.0 else f"{value:.0f}") + ("" if value <= MOST.get(name, math.inf) else "!")


def main() -> None:
    """Measure, print, keep."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", nargs="+", default=["escher", "thor"])
    parser.add_argument("--variants", nargs="+", default=list(VARIANTS), choices=VARIANTS)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--trials", nargs="+", default=list(TRIALS), choices=list(TRIALS))
    parser.add_argument("--json", type=Path, help="where to keep every run")
    arguments = parser.parse_args()
    runs: list[Run] = []
    with tempfile.TemporaryDirectory(prefix="valor-") as home:
        for robot in arguments.robot:
            for variant in arguments.variants:
                for seed in arguments.seeds:
                    runs.append(Run(robot, variant, seed))
                    try:
                        measure(Path(home), runs[-1], arguments.trials)
                    except ValorError as error:
                        runs[-1].troubles.append(str(error))
                    if arguments.json:
                        arguments.json.write_text(json.dumps([asdict(each) for each in runs], indent=1) + "\n")
    for line in tables(runs):
        print(line)
    sys.exit(any(run.troubles for run in runs))


if __name__ == "__main__":
    main()
