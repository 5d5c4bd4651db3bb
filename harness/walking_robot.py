"""A robot that walks in one process, and whose Motion Manager dies again and again, each time from where it walks."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum

import mujoco
import numpy as np

from harness.robot_in_process import RobotInProcess
from valor.common.arrays import FloatArray
from valor.common.behaviors import Behavior
from valor.robot.description import RobotDescription
from valor.whole_body.reflex import BalanceReflex

HELD = 3.0  # afterwards, by the joints' servos: who falls does so within it [s]
STILL = 0.01  # the pelvis [m/s, rad/s]
FALLEN = 0.2  # the pelvis, lower than it was [m]


class Then(Enum):
    """What is done about a robot that nobody leads any more."""

    HOLD = "held"
    REFLEX = "reflex"


@dataclass(frozen=True, slots=True)
class End:
    """What became of it."""

    fell: bool
    way: float  # of the pelvis in the plane [m]
    time: float = 0.0  # of the reflex [s]
    peak: float = 0.0  # of the DCM's error meanwhile [m]
    outcome: str = ""


class WalkingRobot(RobotInProcess):
    """It stands, in Walk, when it is made."""

    def __init__(self, robot: RobotDescription, profile: str, seed: int) -> None:
        super().__init__(robot, profile, seed)
        self._robot = robot
        self._reflex = BalanceReflex(robot)
        assert not (refused := self.stand_up()), refused
        self.run(1.0)
        assert not self.ask(Behavior.WALK)

    def abandon(self, then: Then, blind: int = 0) -> End:
        """Let nobody lead it, and see what becomes of it; then it is back where it was, and walks on.

        Args:
            then: what is done.
            blind: periods that go by with the last Motor, before it is known that no other one comes.
        """
        with self._put_back():
            start = self.plant.data.qpos[:3].copy()
            self._pass(blind, start)
            reflex = self._reflex
            reflex.begin(self.motor)
            while then is Then.REFLEX and not (reflex.done or self._lies(start)):
                self._sequence += 1
                measured = self._sensors.measure(self._sequence, round(self.time * 1e9))
                motor = reflex.update(measured)
                self.plant.actuators.obey(motor)
                self.plant.step(self._substeps)
            if not reflex.limp:
                self.plant.actuators.hold(self.plant.joint_position, self.plant.actuators.effort.copy())
            self._pass(round(HELD / self._period), start)
            way = float(np.linalg.norm((self.plant.data.qpos[:3] - start)[:2]))
            return End(self._lies(start), way, reflex.time, reflex.peak, reflex.outcome)

    def _pass(self, periods: int, start: FloatArray) -> None:
        """So many periods with whatever the motors have, or until it lies, or has come to rest."""
        still = 0
        for _ in range(periods):
            still = still + 1 if np.abs(self.plant.data.qvel[:6]).max() < STILL else 0
            if self._lies(start) or still * self._period > 0.5:
                return
            self._sequence += 1
            self.plant.step(self._substeps)

    def _lies(self, start: FloatArray) -> bool:
        return bool(self.plant.data.qpos[2] < start[2] - FALLEN)

    @contextmanager
    def _put_back(self) -> Iterator[None]:
        """Whatever happens to the plant within is undone."""
        plant, sequence = self.plant, self._sequence
        model, data, actuators = plant.model.mj, plant.data, plant.actuators
        everything = mujoco.mjtState.mjSTATE_INTEGRATION
        state = np.zeros(mujoco.mj_stateSize(model, everything))
        mujoco.mj_getState(model, data, state, everything)
        plant.actuators = copy.deepcopy(actuators, {id(self._robot): self._robot})
        try:
            yield
        finally:
            plant.actuators, self._sequence = actuators, sequence
            mujoco.mj_setState(model, data, state, everything)
            mujoco.mj_forward(model, data)
