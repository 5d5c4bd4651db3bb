"""Standing for an hour of simulated time: does the robot drift, does memory grow?

Plant and Motion Manager in one process, without sockets, as fast as it goes; profile ``hardware``. One row a stretch of
simulated time, so that a run that is broken off has said something. Positions are the simulator's truth.

    .venv/bin/python benchmarks/endurance.py [--hours 1] [--rows 12] [--seed 0] [--profile hardware]
"""

from __future__ import annotations

import argparse
import gc
import os
import sys
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the services run; NumPy reads it once

import numpy as np
import psutil

from harness.closed_loop import load_robot
from valor.common.behaviors import Behavior
from valor.common.messages import BehaviorRequest, MotionState
from valor.motion_manager.handlers.behavior import BehaviorHandler
from valor.motion_manager.manager import MotionManager
from valor.robot.model import controller_model
from valor.simulation.plant import Plant
from valor.simulation.sensors import Sensors

SETTLING = 20.0  # from the servos' posture to the controller's, and until the DCM's integral has settled [s]
SAMPLE = 1.0  # [s]


class Standing:
    """A robot that the Motion Manager has brought to Stand."""

    def __init__(self, robot_name: str, profile: str, seed: int) -> None:
        self.robot = robot = load_robot(robot_name)
        self.plant = Plant(robot, "flat", profile, seed)
        self.sensors = Sensors(robot, self.plant, robot.tables.actuators[profile].noise, seed)
        self.manager = MotionManager(robot, controller_model(robot))
        self.report: MotionState
        self.sequence = 0
        self._substeps = round(robot.control_period / self.plant.step_time)
        self.plant.actuators.hold(robot.nominal_posture)
        self.run(3.0)
        reply = BehaviorHandler.of(self.manager.parts).handle(BehaviorRequest(behavior=Behavior.STAND), "benchmark")
        if not reply.accepted:
            sys.exit(f"stand refused: {reply.reason}")
        self.run(SETTLING)

    @property
    def time(self) -> float:
        """Robot time [s]."""
        return self.sequence * self.robot.control_period

    def run(self, seconds: float) -> None:
        """Go on."""
        for _ in range(round(seconds / self.robot.control_period)):
            measured = self.sensors.measure(self.sequence, round(self.time * 1e9))
            self.plant.actuators.obey(self.manager.tick(measured))
            self.report = self.manager.report(0.0)
            self.plant.step(self._substeps)
            self.sequence += 1

    def place(self) -> np.ndarray:
        """(3,) true pelvis position [m]."""
        place: np.ndarray = self.plant.data.qpos[:3].copy()
        return place


def main() -> None:
    """Stand, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="escher")
    parser.add_argument("--profile", default="hardware")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--rows", type=int, default=12)
    options = parser.parse_args()
    np.seterr(all="ignore")  # as the service runs
    standing = Standing(options.robot, options.profile, options.seed)
    process = psutil.Process()
    gc.collect()
    gc.freeze()
    gc.disable()  # as the service runs: what only the collector frees is a leak
    first, believed = standing.place(), standing.report.pelvis_position_in_odom
    memory = process.memory_info().rss
    print(f"## Standing {options.hours:g} h of simulated time, {options.profile}, seed {options.seed}\n")
    print(
        "| after [min] | pelvis from where it was: x, y, z [mm] | farthest in between [mm] | odometry's error [mm] "
        "| QP failures | memory gained [MiB] | behavior | faster than real time |"
    )
    print("|---|---|---|---|---|---|---|---|", flush=True)
    for row in range(options.rows):
        farthest, began = 0.0, time.perf_counter()
        seconds = 3600.0 * options.hours / options.rows
        for _ in range(round(seconds / SAMPLE)):
            standing.run(SAMPLE)
            farthest = max(farthest, float(np.linalg.norm(standing.place() - first)))
        way, report = standing.place() - first, standing.report
        odometry = np.linalg.norm(report.pelvis_position_in_odom - believed - way)
        print(
            f"| {(row + 1) * seconds / 60:.1f} | {', '.join(f'{1e3 * c:+.2f}' for c in way)} | {1e3 * farthest:.2f} "
            f"| {1e3 * odometry:.2f} | {report.qp_failures} | {(process.memory_info().rss - memory) / 2**20:+.2f} "
            f"| {report.behavior} | {seconds / (time.perf_counter() - began):.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
