"""Exchanges of controllers at random times: standing, and walking.

    python -m benchmarks.exchanges ROBOT CONTROLLER [--profile hardware] [--exchanges 50] [--speed 0 0.3]

ROBOT is a name or a folder whose robot.yaml has the controller in ``controllers`` for standing and walking. A row of
the table is one way of exchanging, from or to the Whole-Body Controller. The largest step of a joint's torque between
two periods, in the half second after an exchange began, includes those of the controllers: the largest of each without
an exchange is beside it, and the largest that the progress of the blend causes.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from unittest.mock import patch

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.behaviors import Behavior
from valor.common.resources import robot_folder
from valor.control.controller import JointCommand
from valor.motion_manager.controllers import controller_factories
from valor.motion_manager.locomotion import exchange
from valor.motion_manager.locomotion.exchange import blended
from valor.motion_manager.locomotion.supervision import servo_torque
from valor.robot.description import RobotDescription
from valor.robot.motion_tables import WHOLE_BODY
from valor.self_test.robot_in_process import RobotInProcess

BLEND, LONGEST = 0.5, 5.0  # looked at after an exchange; waited for one [s]


@dataclass
class Row:
    """Exchanges of one kind."""

    done: int = 0
    rejected: int = 0
    falls: int = 0
    waited: list[float] = field(default_factory=list)  # from the request to control [s]
    step: float = 0.0  # largest of a joint's torque, fraction of its limit
    own: float = 0.0  # likewise, caused by the progress of the blend


class Exchanges:
    """A robot whose controllers are exchanged again and again; after a fall, a new one."""

    def __init__(self, robot: RobotDescription, profile: str, controller: str, velocity: float) -> None:
        self._robot, self._profile, self._controller = robot, profile, controller
        self._velocity, self._seed = (velocity, 0.0, 0.0), 0
        self.usual = {WHOLE_BODY: 0.0, controller: 0.0}  # largest step of a torque without an exchange, as a fraction
        self._share = self._own = 0.0  # of the blend, the last and its largest effect
        self._rng = np.random.default_rng(0)
        self._begin()

    def _begin(self) -> None:
        self._seed += 1
        others = controller_factories(self._robot)
        self._loop = loop = RobotInProcess(self._robot, self._profile, self._seed, others=others)
        self._effort: FloatArray = loop.plant.actuators.effort.copy()
        loop.stand_up()
        self._pass(1.0)
        if self._velocity[0]:
            loop.ask(Behavior.WALK)
            self._pass(3.0)

    def _pass(self, seconds: float) -> float:
        """Run for a time; returns the largest step of a torque."""
        largest = 0.0
        for _ in range(round(seconds / self._robot.control_period)):
            self._loop.walk(self._velocity, self._robot.control_period)
            effort = self._loop.plant.actuators.effort
            largest = max(largest, float((np.abs(effort - self._effort) / self._robot.effort_limit).max()))
            self._effort[:] = effort
        return largest

    def _blended(self, one: JointCommand, other: JointCommand, share: float) -> JointCommand:
        """Return what ``blended`` does, and measure how much the growth of the share changes the torques."""
        state = self._loop.manager.components.state
        assert state is not None
        change = np.abs(servo_torque(other, state) - servo_torque(one, state)) / self._robot.effort_limit
        self._own = max(self._own, (share - self._share) * float(change.max()))
        self._share = share
        return blended(one, other, share)

    def run(self, count: int) -> dict[str, Row]:
        """Exchange to and fro so many times."""
        with patch.object(exchange, "blended", self._blended):
            return self._run(count)

    def _run(self, count: int) -> dict[str, Row]:
        rows = {self._controller: Row(), WHOLE_BODY: Row()}
        for i in range(2 * count):
            name = (self._controller, WHOLE_BODY)[i % 2]
            self._exchange(name, rows[name])
            if self._loop.behavior in (Behavior.FALL, Behavior.SOFT_STOP):
                self._begin()
        return rows

    def _exchange(self, name: str, row: Row) -> None:
        components = self._loop.manager.components
        active = components.exchange.active.name
        self.usual[active] = max(self.usual[active], self._pass(self._rng.uniform(0.5, 2.0)))
        asked, self._own = self._loop.time, 0.0
        refused = components.exchange.choose(name, components.state)
        while not refused and components.exchange.active.name != name and self._loop.time < asked + LONGEST:
            self._pass(self._robot.control_period)
        if refused or components.exchange.active.name != name:
            row.rejected += 1
            print(f"  {name}: {refused or components.exchange.reason}")
            return
        row.waited.append(self._loop.time - asked)
        row.step, row.own = max(row.step, self._pass(BLEND)), max(row.own, self._own)
        self._pass(1.0)
        if self._loop.behavior is Behavior.FALL or components.exchange.active.name != name:
            row.falls += 1
            print(f"  {name}: {self._loop.manager.fsm.reason}")
            return
        row.done += 1


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robot")
    parser.add_argument("controller")
    parser.add_argument("--profile", default="hardware")
    parser.add_argument("--exchanges", type=int, default=50, help="each way")
    parser.add_argument("--speed", type=float, nargs="+", default=(0.0, 0.3), help="0: standing [m/s]")
    options = parser.parse_args()
    robot = RobotDescription.load(robot_folder(options.robot))
    print(f"{robot.name}, {options.profile}, {options.controller}")
    print("| | to | done | rejected | failed | waited, median, most [s] | largest step | without exchange | blend |")
    print("|---|---|---|---|---|---|---|---|---|")
    for speed in options.speed:
        what = f"walking {speed:g} m/s" if speed else "standing"
        exchanges = Exchanges(robot, options.profile, options.controller, speed)
        for to, row in exchanges.run(options.exchanges).items():
            waited = f"{np.median(row.waited):.2f}, {max(row.waited):.2f}" if row.waited else "–"
            usual = ", ".join(f"{each:.0%}" for each in exchanges.usual.values())
            steps = f"{row.step:.0%}", usual, f"{row.own:.1%}"
            cells = (what, to, row.done, row.rejected, row.falls, waited, *steps)
            print(f"| {' | '.join(map(str, cells))} |", flush=True)


if __name__ == "__main__":
    main()
