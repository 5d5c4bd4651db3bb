"""The two clocks of the simulation, and how robot time is kept beside the wall's.

``lockstep``: each state waits for the Motor that answers it; a slow machine slows the clock, not the robot.
``realtime``: time passes by itself, and stands only while the newest Motor answers a state too long ago (bounded
staleness). Neither ever catches up on missed periods: when late, the schedule moves, and the lost time is slip.
"""

from __future__ import annotations

import ctypes
import time
from abc import ABC, abstractmethod

from comms_manager.commands import Commands
from valor_simulation.plant import Plant

PATIENCE = 1.0  # of one wait for a Motor [s]
STALENESS = 5  # realtime: periods that the state answered by the newest Motor may lie back
LATE = 0.002  # behind the schedule by more than this, the schedule moves [s]


class Wall:
    """The wall clock."""

    def __init__(self) -> None:
        # Linux wakes a sleeper up to 50 µs late to save energy, unless asked not to (PR_SET_TIMERSLACK).
        ctypes.CDLL(None).prctl(29, 1000, 0, 0, 0)

    def now(self) -> float:
        """[s]."""
        return time.perf_counter()

    def sleep(self, duration: float) -> None:
        """Sleep [s]."""
        time.sleep(duration)


class Pacer:
    """Keeps robot time to a schedule on the wall.

    Attributes:
        slip: robot time lost: how much less has passed than the schedule first had it [s].
    """

    def __init__(self, rate: float, wall: Wall) -> None:
        """``rate``: robot time to wall time; 0: no schedule."""
        self._rate = rate
        self._wall = wall
        self._due: float | None = None
        self.slip = 0.0

    def pass_time(self, duration: float, at_least_real_time: bool = False) -> float:
        """Let a duration of robot time pass: sleep until its end is due. Returns the time slept [s].

        Args:
            duration: [s].
            at_least_real_time: keep to real time where there is no schedule.
        """
        rate = self._rate or (1.0 if at_least_real_time else 0.0)
        now = self._wall.now()
        if self._due is None or not rate:
            self._due = now
        if not rate:
            return 0.0
        self._due += duration / rate
        if now < self._due:
            self._wall.sleep(self._due - now)
            return self._wall.now() - now
        if now - self._due > LATE:
            if self._rate:
                self.slip += (now - self._due) * rate
            self._due = now
        return 0.0


class Clock(ABC):
    """How one control period passes."""

    name: str

    def __init__(self, plant: Plant, steps: int, pacer: Pacer) -> None:
        self._plant = plant
        self._steps = steps
        self._pacer = pacer
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
        return self._pacer.pass_time(due, self._unhurried)

    def _step(self, count: int) -> None:
        self._plant.step(count)
        self._due += count * self._plant.step_time

    def _obey(self, commands: Commands) -> None:
        """Hand the newest Motor to the actuators, or have them hold."""
        if commands.silent:
            if not self._holding:
                self._holding = True
                self._plant.actuators.hold(self._plant.joint_position)
        elif commands.admitted != self._admitted and commands.motor is not None:
            self._holding = False
            self._plant.actuators.obey(commands.motor)
        self._admitted = commands.admitted

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
        if commands.silent:
            commands.take()
        else:
            waited += self._wait(commands, age=0)
        self._obey(commands)
        self._step(self._steps)
        # Without a controller nobody wants the robot to age faster than the world.
        self._unhurried = commands.silent
        return waited


class RealTime(Clock):
    """Physics advances on the wall's schedule with whatever Motor has arrived, if that is not too old."""

    name = "realtime"

    def advance(self, commands: Commands) -> float:
        """Step the plant through one control period; returns the time spent waiting [s]."""
        waited = 0.0
        commands.take()
        if not commands.silent and commands.age > STALENESS:
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
