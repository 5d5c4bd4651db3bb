"""What becomes of a robot whose Motion Manager is killed while it walks, live, at the wall's pace.

Each time the Motion Manager is killed (SIGKILL) at a phase drawn at random, and started anew at once, as supervisord
would. The robot has fallen when it is let go, or its pelvis ends 0.2 m lower than it was. Where it stays on its feet,
it stands up from Freeze for the next time; otherwise, and on stairs, the system begins anew.

``python -m benchmarks.killed_live flat|dirt|stairs|devices … [--kills N] [--seed S]`` prints a line a kill, then a
table.
"""

from __future__ import annotations

import argparse
import random
import re
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

import numpy as np

from benchmarks.flights import over_stairs
from harness.device_system import Newest, RobotOnDevices, on_devices
from harness.instance import RunningInstance, fresh_instance
from harness.waiting import wait_until
from valor.common.messages import (
    Footstep,
    FootstepPlanRequest,
    VelocityCommand,
)
from valor.common.topics import FOOTSTEP_PLAN, GROUND_TRUTH, PROPRIOCEPTOR, VELOCITY
from valor.robot.description import RobotDescription
from valor.robot.step_plan import FEET
from valor.simulation import worlds
from valor.simulation.worlds.stairs import Stairs

SPEED = 0.3  # [m/s]
WALKED = 3.0  # before the first phase that it may be killed at [s of robot time]
SPREAD = 2.64  # over which the phases are: four steps [s]
PATIENCE = 60.0  # for anything [s]
AFTERWARDS = 2.0  # that it is looked at, once it is held [s of robot time]
FALLEN = 0.2  # the pelvis, lower than it was [m]
_ENDED = re.compile(r"the balance reflex has ended: (.*), after ([\d.]+) s; DCM off by ([\d.]+) m")


@contextmanager
def _simulated(world: str, seed: int) -> Iterator[RunningInstance]:
    with (
        tempfile.TemporaryDirectory(prefix="valor-", ignore_cleanup_errors=True) as home,
        fresh_instance(Path(home), world=world, seed=seed, actuators="hardware", real_time_factor=1.0) as running,
    ):
        for name in ("comms_manager", "motion_manager"):
            running.start(name)
        running.wait_ready("motion_manager", PATIENCE)
        yield running


@dataclass(frozen=True)
class Row:
    """Where and in what it is killed.

    Attributes:
        note: for the table.
        begin: a system, by seed.
        stairs: the world's, if it is killed in a plan over them.
    """

    note: str
    begin: Callable[[int], AbstractContextManager[RunningInstance]]
    stairs: str = ""


ROWS = {
    "flat": Row("0.3 m/s on the flat, `sim`", lambda seed: _simulated("flat", seed)),
    "dirt": Row("0.3 m/s on the dirt, `sim`", lambda seed: _simulated("dirt", seed)),
    "stairs": Row("a plan over stairs of 10 cm, `sim`", lambda seed: _simulated("stairs", seed), "stairs"),
    "devices": Row(
        "0.3 m/s on the flat, emulated devices", lambda seed: on_devices("hdt_driver", "hdt_bridge", seed=seed)
    ),
}


@dataclass
class End:
    """What became of it."""

    contacts: int  # feet on the ground when it was killed
    behavior: str  # in which it was found
    lower: float  # the pelvis, than it was [m]
    way: float  # of the pelvis meanwhile [m]
    reflex: tuple[str, float, float] | None  # outcome, time [s], DCM's largest error [m]; None: it was not needed

    @property
    def fell(self) -> bool:
        """Whether it lies, or was let go."""
        return self.behavior != "freeze" or self.lower > FALLEN


class Robot(RobotOnDevices):
    """One robot, whose Motion Manager dies."""

    def __init__(self, running: RunningInstance) -> None:
        super().__init__(running)
        self._truth = Newest(GROUND_TRUTH.subscriber(self.node))
        self._measured = Newest(PROPRIOCEPTOR.subscriber(self.node))
        self._velocity = VELOCITY.publisher(self.node)
        self._plans = FOOTSTEP_PLAN.client(self.node)

    def walk(self, seconds: float) -> None:
        """Straight ahead, for so long [robot time]."""
        self.go("walk")
        until = self.state.time + round(1e9 * seconds)

        def done() -> bool:
            now = self.state.time
            self._velocity.publish(VelocityCommand(now, SPEED, 0.0, 0.0))
            return now >= until

        wait_until(done, PATIENCE, "the way")

    def climb(self, world: str, share: float) -> None:
        """Up to a share of the plan over a world's stairs."""
        stairs = worlds.WORLDS[world]
        assert isinstance(stairs, Stairs)
        plan = over_stairs(RobotDescription.load(self.running.settings.robot).tables, stairs)
        self.go("step")
        steps = [
            Footstep(
                i, FEET.index(step.foot), np.array([step.x, step.y, step.z]), np.array([1.0, 0.0, 0.0, 0.0]),
                step.swing_height, step.step_duration, step.sway_duration,
            )
            for i, step in enumerate(plan)
        ]  # fmt: skip
        reply = self._plans.call(FootstepPlanRequest(steps), timeout=PATIENCE)
        assert reply.accepted, reply.reason
        until = self.state.time + round(1e9 * share * 1.3 * len(plan))  # about the plan's duration
        wait_until(lambda: self.state.time >= until or self.behavior != "step", PATIENCE, "its place in the plan")

    def kill(self) -> End:
        """Kill the Motion Manager, start it anew, and wait until the robot is in its hands again."""
        contacts = int(self.state.contacts.sum())
        before = self._truth().pelvis_position_in_world.copy()
        told = len(_ENDED.findall(self.running.log("comms_manager")))
        self.running.kill("motion_manager")
        self.running.start("motion_manager")
        wait_until(lambda: self._measured().motor_behavior in ("freeze", "fall"), PATIENCE, "it is taken over")
        until = self._measured().time + round(1e9 * AFTERWARDS)
        wait_until(lambda: self._measured().time >= until, PATIENCE, "it goes on standing")
        self.running.wait_ready("motion_manager", PATIENCE)
        after = self._truth().pelvis_position_in_world
        ended = _ENDED.findall(self.running.log("comms_manager"))[told:]
        return End(
            contacts,
            self._measured().motor_behavior,
            float(before[2] - after[2]),
            float(np.linalg.norm((after - before)[:2])),
            (ended[0][0], float(ended[0][1]), float(ended[0][2])) if ended else None,
        )


@dataclass
class Bench:
    """The kills of one row."""

    row: Row
    seed: int
    ends: list[End] = field(default_factory=list)

    def run(self, kills: int) -> None:
        """So many."""
        draw = random.Random(self.seed)
        while len(self.ends) < kills:
            with self.row.begin(self.seed + len(self.ends)) as running:
                robot = Robot(running)
                while len(self.ends) < kills:
                    robot.go("stand")
                    if self.row.stairs:
                        robot.climb(self.row.stairs, draw.uniform(0.1, 0.9))
                    else:
                        robot.walk(WALKED + draw.uniform(0.0, SPREAD))
                    end = robot.kill()
                    self.ends.append(end)
                    print(f"{time.strftime('%H:%M:%S')} {end}", flush=True)
                    if end.fell or self.row.stairs:
                        break

    def show(self) -> str:
        """A row of the table."""
        led = [end.reflex for end in self.ends if end.reflex]
        stood = [end for end in self.ends if not end.fell]
        times = [seconds for _, seconds, _ in led]
        off = 100.0 * max(error for *_, error in led)
        way = 100.0 * max((end.way for end in stood), default=0.0)
        return (
            f"| {self.row.note} | {len(self.ends)} | {sum(end.contacts < 2 for end in self.ends)} "
            f"| {sum(end.fell for end in self.ends)} | {median(times):.1f}, {max(times):.1f} | {off:.0f} | {way:.0f} |"
        )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rows", nargs="+", choices=list(ROWS))
    parser.add_argument("--kills", type=int, default=12, help="of each row")
    parser.add_argument("--seed", type=int, default=0, help="of the phases and of the robot's errors")
    arguments = parser.parse_args()
    benches = [Bench(ROWS[name], arguments.seed) for name in arguments.rows]
    for bench in benches:
        bench.run(arguments.kills)
    print("| walking | kills | on one foot | fallen | stands after, median, most [s] ", end="")
    print("| DCM off, most [cm] | pelvis moves, most [cm] |\n" + "|---" * 7 + "|")
    for bench in benches:
        print(bench.show())


if __name__ == "__main__":
    main()
