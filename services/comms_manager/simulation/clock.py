"""The two clocks of the simulation, and how robot time is kept beside the wall's.

``lockstep``: each state waits for the Motor that answers it, and for the cycle of the VRC (``in_step``); a slow machine
slows the clock, not the robot.
``realtime``: time passes by itself, and stands only while the newest Motor answers a state too long ago (bounded
staleness). Both make up what is late, a quarter quicker than their pace at most; what the wall is ahead by more than
``BACKLOG`` is not made up, and told as slip.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod

from valor.common.pacing import Pacer
from valor.common.trace import Stage, Tracer
from valor.comms_manager.commands import Commands
from valor.comms_manager.simulation.in_step import InStep
from valor.simulation.plant import Plant

BACKLOG = 0.2  # a stall longer than this is not made up [s]
HASTE = 1.25  # of the pace, while something is made up: Motor still comes within the period that it is for
PATIENCE = 1.0  # of one wait for a Motor [s]
STALENESS = 5  # realtime: periods that the state answered by the newest Motor may lie back


class Clock(ABC):
    """How one control period passes."""

    name: str

    def __init__(self, plant: Plant, steps: int, pacer: Pacer, trace: Tracer, in_step: InStep | None = None) -> None:
        self._plant = plant
        self._steps = steps
        self._pacer = pacer
        self._trace = trace
        self._in_step = in_step
        self._due = 0.0  # robot time that has passed in the plant and not yet on the wall [s]
        self._unhurried = False  # keep to real time where there is no schedule
        self._admitted = 0
        self._holding = False

    @abstractmethod
    def advance(self, commands: Commands) -> float:
        """Step the plant through one control period; returns the time spent waiting [s]."""

    def pace(self) -> float:
        """Sleep until the wall is where the plant is; returns the time slept [s]."""
        due, self._due = self._due, 0.0
        slept = self._pacer.pass_time(due, self._unhurried)
        if slept > 0.0:
            self._trace.mark(Stage.SLEEP, at=self._pacer.end)
            self._trace.mark(Stage.OVERSLEEP)
        return slept

    def _step(self, count: int) -> None:
        self._plant.step(count)
        self._due += count * self._plant.step_time
        self._trace.mark(Stage.PHYSICS)

    def _obey(self, commands: Commands) -> None:
        """Hand the newest Motor to the actuators, or have them hold."""
        self._trace.mark(Stage.AWAIT_MOTOR)
        leader = commands.leader
        if leader.silent and not leader.limp:
            if not self._holding:
                self._holding = True
                actuators = self._plant.actuators
                actuators.hold(self._plant.joint_position, actuators.effort.copy())
        elif leader.admitted != self._admitted and leader.motor is not None:
            self._holding = False
            self._plant.actuators.obey(leader.motor)
        self._admitted = leader.admitted

    @staticmethod
    def _wait(commands: Commands, age: int) -> float:
        began = time.perf_counter()
        commands.wait(PATIENCE, age)
        return time.perf_counter() - began


class Lockstep(Clock):
    """Physics advances one period with the Motor that answers the state at its beginning."""

    name = "lockstep"

    def advance(self, commands: Commands) -> float:
        """Step the plant through one control period; returns the time spent waiting [s]."""
        waited = 0.0
        if commands.leader.silent:
            commands.take()
        else:
            waited += self._wait(commands, age=0)
        if self._in_step is not None:
            waited += self._in_step.wait(commands.newest)
        self._obey(commands)
        self._step(self._steps)
        # Without a controller nobody wants the robot to age faster than the world.
        self._unhurried = commands.leader.abandoned
        return waited


class RealTime(Clock):
    """Physics advances on the wall's schedule with whatever Motor has arrived, if that is not too old."""

    name = "realtime"

    def advance(self, commands: Commands) -> float:
        """Step the plant through one control period; returns the time spent waiting [s]."""
        waited = 0.0
        commands.take()
        if not commands.leader.silent and commands.age > STALENESS:
            waited += self._wait(commands, age=STALENESS)
        self._obey(commands)
        # A Motor usually arrives within one physics step: it acts from the second on, as it would on a robot.
        self._step(1)
        if self._steps > 1:
            waited += self.pace()
            commands.take()
            self._obey(commands)
            self._step(self._steps - 1)
        return waited


CLOCKS: dict[str, type[Clock]] = {clock.name: clock for clock in (Lockstep, RealTime)}
