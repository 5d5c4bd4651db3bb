"""Checks Motor messages and detects their timeout."""

import logging
import math
import time

import bifrost
from valor.common.behaviors import Reaction
from valor.common.messages import JointMode, Motor, Proprioceptor
from valor.comms_manager.command_arbiter import CommandArbiter
from valor.robot.description import RobotDescription

COMMAND_TIMEOUT = 0.1  # timeout of Motor in robot time, after which the joints hold [s]
MISSES_TO_SILENCE = 3  # consecutive wait timeouts, after which the joints hold
AT_ONCE = 16  # largest number of Motors processed per period
TAKING = 5e-4  # largest duration of that [s]
ABSENCE = 5  # periods without an answer, after which the publishers of Motor are checked
_LOOK_EVERY = 0.05  # period of checking the publishers of Motor while waiting [s]
_HIGHEST_MODE = max(JointMode)
_LOG_EVERY = 10.0  # per kind of rejection [s]
_log = logging.getLogger("comms_manager")


class Commands:
    """Receives Motor messages, rejects invalid ones whole, and detects their timeout.

    A Motor contains the sequence of the Proprioceptor that it answers. It is rejected if that state is of another run
    of this process, older than one already answered, or older than the timeout; or if its Motion Manager started before
    the active one.
    """

    def __init__(self, subscriber: bifrost.Subscriber[Motor], robot: RobotDescription, arbiter: CommandArbiter) -> None:
        self.arbiter = arbiter  # selects the active Motor
        self._subscriber = subscriber
        self._length = len(robot.joints)
        self._max_age = round(COMMAND_TIMEOUT * robot.tables.control_rate)
        self._first = 0
        self.current = 0  # sequence of the latest published Proprioceptor
        self._answered = 0
        self._time = self._admitted_at = 0
        self._writer = 0
        self._misses = 0
        self._logged: dict[str, float] = {}
        self.rejected = 0
        self.waits_timed_out = 0

    def measured(self, state: Proprioceptor, demand: Reaction) -> None:
        """Note a published Proprioceptor, which later Motors may answer; ``demand``: of the devices."""
        arbiter = self.arbiter
        self._first = self._first or state.sequence
        self.current, self._time = state.sequence, state.time
        arbiter.measured(state)
        if arbiter.motor is not None and not arbiter.abandoned:
            if self._time - self._admitted_at > COMMAND_TIMEOUT * 1e9:
                arbiter.abandon(f"no Motor for {COMMAND_TIMEOUT:g} s of robot time")
            elif self.age > ABSENCE and not self._subscriber.publishers:
                arbiter.abandon("no process publishes Motor any more")
        if arbiter.balancing:
            self.take()
        if arbiter.answer(demand):
            self._answered = state.sequence

    @property
    def age(self) -> int:
        """Periods between the latest state and the one that the active Motor answers."""
        return self.current - self._answered

    @property
    def drops(self) -> int:
        return self._subscriber.drops

    def take(self) -> None:
        """Process waiting Motors, within the limits of a period; never blocks."""
        for received in self._subscriber.drain(AT_ONCE, TAKING):
            self._consider(received.message, received.origin)

    def wait(self, timeout: float, age: int = 0) -> bool:
        """Wait until the active Motor answers a state at most ``age`` periods old; returns whether it does.

        A timeout [s] is counted; after ``MISSES_TO_SILENCE`` of them, or at once if no process publishes Motor, the
        arbiter is notified.
        """
        deadline = time.perf_counter() + timeout
        arbiter = self.arbiter
        while arbiter.motor is None or self.age > age:
            remaining = deadline - time.perf_counter()
            if remaining <= 0.0:
                if arbiter.motor is not None:
                    self.waits_timed_out += 1
                    self._misses += 1
                    if self._misses >= MISSES_TO_SILENCE:
                        arbiter.abandon(f"{self._misses} waits of {timeout:g} s for a Motor timed out")
                return False
            received = self._subscriber.receive(timeout=min(remaining, _LOOK_EVERY))
            if received is not None:
                self._consider(received.message, received.origin)
            elif arbiter.motor is not None and not self._subscriber.publishers:
                arbiter.abandon("no process publishes Motor any more")
                return False
        self._misses = 0
        return True

    def listen(self, timeout: float) -> None:
        """Process waiting Motors, or the next within ``timeout`` [s]; a timeout is not counted.

        For hardware, where Motor times out by ``COMMAND_TIMEOUT`` only.
        """
        before = self.arbiter.admitted
        self.take()
        if self.arbiter.admitted == before and timeout > 0.0:
            received = self._subscriber.receive(timeout=timeout)
            if received is not None:
                self._consider(received.message, received.origin)

    @property
    def answered(self) -> bool:
        """True if the active Motor answers the latest state."""
        return self.arbiter.motor is not None and self.age <= 0

    def _consider(self, motor: Motor, origin: str) -> None:
        """Admit a Motor, or count and log its rejection; Motors that the arbiter does not accept are ignored."""
        if not self.arbiter.accepts(motor):
            return
        if reason := self._fault(motor):
            self.rejected += 1
            kind = reason.partition(":")[0]
            now = time.monotonic()
            if now - self._logged.get(kind, -_LOG_EVERY) >= _LOG_EVERY:
                self._logged[kind] = now
                _log.warning("Motor from %s rejected: %s (%d rejected since start)", origin, reason, self.rejected)
        elif self.arbiter.follow(motor, origin):
            self._answered = motor.proprioceptor_sequence
            self._admitted_at = self._time
            self._writer = motor.writer
            self._misses = 0

    def _fault(self, motor: Motor) -> str:
        answers = motor.proprioceptor_sequence
        if not self._first:
            return "answers no state: none has been measured yet"
        if not self._first <= answers <= self.current:
            return f"answers no state of this run: {answers}, expected {self._first} to {self.current}"
        if motor.writer < self._writer:
            return f"of an older Motion Manager: started at {motor.writer} ns, the active one at {self._writer} ns"
        if answers < self._answered:
            return f"older than the active one: answers {answers}, expected at least {self._answered}"
        if self.arbiter.motor is not None and self.current - answers > self._max_age:
            return f"too old: answers {answers}, latest is {self.current}, expected at most {self._max_age} periods"
        n, mode = self._length, motor.mode
        position, velocity, effort = motor.position, motor.velocity, motor.effort
        stiffness, damping = motor.stiffness, motor.damping
        if not mode.size == position.size == velocity.size == effort.size == stiffness.size == damping.size == n:
            sizes = ", ".join(str(v.size) for v in (mode, position, velocity, effort, stiffness, damping))
            return f"wrong length: {sizes} (mode, position, velocity, effort, stiffness, damping), expected {n}"
        # A sum of squares is finite if its terms are: one pass a vector, and nothing allocated.
        squares = position.dot(position) + velocity.dot(velocity) + effort.dot(effort)
        if not math.isfinite(squares + stiffness.dot(stiffness) + damping.dot(damping)):
            return "not finite: position, velocity, effort, stiffness or damping"
        if mode.max() > _HIGHEST_MODE:
            return f"unknown mode: {mode.max()}, expected 0 to {_HIGHEST_MODE}"
        if stiffness.min() < 0.0 or damping.min() < 0.0:
            return "negative gain: stiffness or damping"
        return ""
