"""The two clocks of the simulation, and their relation to the wall clock.

``lockstep``: each state waits for the Motor that answers it, and for the cycle of the VRC; a slow machine slows the
clock, not the robot. ``realtime``: time passes independently, and waits only while the latest Motor answers a state too
long ago. Both make up delays up to ``BACKLOG``, at most a quarter faster than their rate; the rest is reported as slip.
"""

import logging
import time
from abc import ABC, abstractmethod

import bifrost
from valor.common.messages import ControllerCycle
from valor.common.pacing import Pacer
from valor.common.trace import Stage, Tracer
from valor.comms_manager.commands import Commands
from valor.simulation.plant import Plant

BACKLOG = 0.2  # largest delay that is made up [s]
HASTE = 1.25  # factor of speed while a delay is made up: Motor still arrives within its period
MOTOR_TIMEOUT = 1.0  # timeout of one wait for a Motor [s]
STALENESS = 5  # realtime: largest age of the state that the latest Motor answers [periods]


CYCLE_TIMEOUT = 1.0  # timeout of a wait for a cycle [s]
SLACK = 1  # periods that a cycle may be late: it then overlaps with the Motion Manager's tick
SLOWEST = 1000  # largest accepted number of periods between two cycles
_LOOK_EVERY = 0.05  # period of checking for a publisher while waiting [s]
_log = logging.getLogger("comms_manager")


class VrcLockstep:
    """Delays robot time until the controller's cycles are done."""

    def __init__(self, cycles: bifrost.Subscriber[ControllerCycle]) -> None:
        """No controller is waited for before its first cycle of this run."""
        self._cycles = cycles
        self._first = self._done = 0
        self._every = 1
        self._followed, self._origin = False, ""
        self.waits_timed_out = 0
        self.note = ""  # controller that is not waited for, and why; an empty string if none

    def wait(self, current: int) -> float:
        """Wait for the cycle due at sequence ``current`` or a disconnection; returns the duration [s]."""
        self._first = self._first or current
        self._receive(self._cycles.latest(), current)
        if not self._followed or current - self._done < self._every + SLACK:
            return 0.0
        began = time.perf_counter()
        deadline = began + CYCLE_TIMEOUT
        while current - self._done >= self._every + SLACK:
            remaining = deadline - time.perf_counter()
            received = self._cycles.receive(min(remaining, _LOOK_EVERY)) if remaining > 0.0 else None
            self._receive(received, current)
            if remaining <= 0.0:
                self.waits_timed_out += 1
                self._leave(f"no cycle within {CYCLE_TIMEOUT:g} s")
                break
            if received is None and not self._cycles.publishers:
                self._leave("it has disconnected")
                break
        return time.perf_counter() - began

    def _receive(self, received: bifrost.Received[ControllerCycle] | None, current: int) -> None:
        if received is None:
            return
        cycle = received.message
        if not self._first <= cycle.proprioceptor_sequence <= current or not 1 <= cycle.every <= SLOWEST:
            return
        self._done, self._every = cycle.proprioceptor_sequence, cycle.every
        if not self._followed:
            self._followed, self._origin, self.note = True, received.origin, ""
            _log.info("in lockstep with %s: a cycle every %d periods", received.origin, cycle.every)

    def _leave(self, why: str) -> None:
        self._followed = False
        self.note = f"{self._origin} is not waited for: {why}"
        _log.warning("%s; robot time continues without it", self.note)


class Clock(ABC):
    """Advances the plant by one control period."""

    name: str

    def __init__(
        self, plant: Plant, steps: int, pacer: Pacer, trace: Tracer, vrc_lockstep: VrcLockstep | None = None
    ) -> None:
        self._plant = plant
        self._steps = steps
        self._pacer = pacer
        self._trace = trace
        self._vrc_lockstep = vrc_lockstep
        self._due = 0.0  # robot time that the plant is ahead of the wall clock [s]
        self._unhurried = False  # keep real time without a schedule
        self._admitted = 0
        self._holding = False

    @abstractmethod
    def advance(self, commands: Commands) -> float:
        """Step the plant through one control period; returns the time spent waiting [s]."""

    def pace(self) -> float:
        """Sleep until the wall clock reaches the plant's time; returns the time slept [s]."""
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

    def _pass_on(self, commands: Commands) -> None:
        """Send the latest Motor to the actuators, or let them hold."""
        self._trace.mark(Stage.AWAIT_MOTOR)
        arbiter = commands.arbiter
        if arbiter.silent and not arbiter.limp:
            if not self._holding:
                self._holding = True
                actuators = self._plant.actuators
                actuators.hold(self._plant.joint_position, actuators.effort.copy())
        elif arbiter.admitted != self._admitted and arbiter.motor is not None:
            self._holding = False
            self._plant.actuators.obey(arbiter.motor)
        self._admitted = arbiter.admitted

    @staticmethod
    def _wait(commands: Commands, age: int) -> float:
        began = time.perf_counter()
        commands.wait(MOTOR_TIMEOUT, age)
        return time.perf_counter() - began


class Lockstep(Clock):
    """Physics advances one period with the Motor that answers the state at its beginning."""

    name = "lockstep"

    def advance(self, commands: Commands) -> float:
        waited = 0.0
        if commands.arbiter.silent:
            commands.take()
        else:
            waited += self._wait(commands, age=0)
        if self._vrc_lockstep is not None:
            waited += self._vrc_lockstep.wait(commands.current)
        self._pass_on(commands)
        self._step(self._steps)
        # Without a controller, robot time does not run faster than real time.
        self._unhurried = commands.arbiter.abandoned
        return waited


class RealTime(Clock):
    """Physics advances with the wall clock and the latest Motor, if it is not too old."""

    name = "realtime"

    def advance(self, commands: Commands) -> float:
        waited = 0.0
        commands.take()
        if not commands.arbiter.silent and commands.age > STALENESS:
            waited += self._wait(commands, age=STALENESS)
        self._pass_on(commands)
        # A Motor usually arrives within one physics step: it acts from the second on, as it would on a robot.
        self._step(1)
        if self._steps > 1:
            waited += self.pace()
            commands.take()
            self._pass_on(commands)
            self._step(self._steps - 1)
        return waited


CLOCKS: dict[str, type[Clock]] = {clock.name: clock for clock in (Lockstep, RealTime)}
