"""How long the robot bears a computer that does not read its IMU: attitude and angular rate stand still meanwhile.

``python benchmarks/blind_imu.py``: standing and walking at 0.3 m/s, three seeds each, three pauses a run. The plant is
profile ``hardware``. ``services/comms_manager/hardware/watch.py`` takes its limit from here.
"""

from __future__ import annotations

import numpy as np

from harness.closed_loop import ClosedLoop, load_robot
from valor.common.messages import Proprioceptor
from valor.whole_body.walking.velocity_steps import VelocitySteps

SPEEDS = (0.0, 0.3)  # [m/s]
PAUSES = (0.1, 0.2, 0.3, 0.5)  # [s]
SEEDS = (1, 2, 3)
BETWEEN = 1.37  # pauses, so that they come at different moments of a step [s]


class Imu:
    """The loop's sensors, whose IMU can stand still."""

    def __init__(self, loop: ClosedLoop) -> None:
        self._measure = loop.sensors.measure
        self._newest: Proprioceptor | None = None
        self.unread = False

    def measure(self, sequence: int, time: int) -> Proprioceptor:
        """As ``Sensors.measure``."""
        measured, newest = self._measure(sequence, time), self._newest
        if self.unread and newest is not None:
            measured.imu_orientation = newest.imu_orientation
            measured.imu_angular_velocity = newest.imu_angular_velocity
            measured.imu_linear_acceleration = newest.imu_linear_acceleration
        else:
            self._newest = measured
        return measured


def run(speed: float, pause: float, seed: int) -> str:
    """Why it fell; empty: it did not."""
    robot = load_robot(control_rate=250.0)
    loop = ClosedLoop(robot, "hardware", seed)
    imu = Imu(loop)
    loop.sensors.measure = imu.measure  # type: ignore[method-assign]
    loop.settle(0.5)
    loop.run(1.0)
    steps = VelocitySteps(robot.tables.walking)
    if speed:
        loop.request.steps = steps

    def each(loop: ClosedLoop) -> None:
        steps.command(np.array((speed, 0.0, 0.0)), loop.time)
        steps.advance(loop.time)

    loop.run(4.0 if speed else 0.1, each)
    for _ in range(3):
        imu.unread = True
        loop.run(pause, each)
        imu.unread = False
        loop.run(BETWEEN, each)
        if loop.fall:
            return loop.fall
    return ""


def main() -> None:
    """A row for each speed and pause."""
    for speed in SPEEDS:
        for pause in PAUSES:
            falls = [run(speed, pause, seed) for seed in SEEDS]
            print(f"{speed:.1f} m/s, unread for {pause:.1f} s: {sum(map(bool, falls))} of {len(falls)} fell")


if __name__ == "__main__":
    main()
