"""Which Motor is obeyed: the newest sound one, until Motor is silent."""

from __future__ import annotations

import logging
import math
import time

import bifrost
from valor.common.behaviors import Reaction
from valor.common.messages import JointMode, Motor, Proprioceptor
from valor.comms_manager.leader import Leader
from valor.robot.description import RobotDescription

COMMAND_TIMEOUT = 0.1  # robot time without a Motor, after which the joints are held [s]
MISSES_TO_SILENCE = 3  # waits timed out in a row, after which the joints are held
AT_ONCE = 16  # Motors that a period takes in, at most
TAKING = 5e-4  # likewise, for how long [s]
ABSENCE = 5  # periods without an answer, after which it is looked whether anybody publishes Motor at all
_LOOK_EVERY = 0.05  # while waiting: whether anybody publishes Motor at all [s]
_HIGHEST_MODE = max(JointMode)
_LOG_EVERY = 10.0  # of each kind of refusal [s]
_log = logging.getLogger("comms_manager")


class Commands:
    """Takes Motor messages in, refuses unsound ones whole, and tells when Motor has fallen silent.

    A Motor says which Proprioceptor it answers. One that answers a state of another world (before a restart of this
    process), a state older than that answered already, or one older than the time-out is not obeyed, nor one of a
    Motion Manager that began before the one obeyed last.

    Attributes:
        leader: has the Motor in force, and who leads the robot when none comes.
        refused: how many were refused.
        waits_timed_out: how often ``wait`` gave up.
    """

    def __init__(self, subscriber: bifrost.Subscriber[Motor], robot: RobotDescription, leader: Leader) -> None:
        self.leader = leader
        self._subscriber = subscriber
        self._length = len(robot.joints)
        self._max_age = round(COMMAND_TIMEOUT * robot.tables.control_rate)
        self._first = self._current = 0
        self._answered = 0
        self._time = self._admitted_at = 0
        self._writer = 0
        self._misses = 0
        self._logged: dict[str, float] = {}
        self.refused = 0
        self.waits_timed_out = 0

    def measured(self, state: Proprioceptor, demand: Reaction) -> None:
        """A Proprioceptor was published: what is admitted from now on answers it at the newest.

        Args:
            state: it.
            demand: of the devices.
        """
        leader = self.leader
        self._first = self._first or state.sequence
        self._current, self._time = state.sequence, state.time
        leader.measured(state)
        if leader.motor is not None and not leader.abandoned:
            if self._time - self._admitted_at > COMMAND_TIMEOUT * 1e9:
                leader.abandon(f"no Motor for {COMMAND_TIMEOUT:g} s of robot time")
            elif self.age > ABSENCE and not self._subscriber.publishers:
                leader.abandon("nobody publishes Motor any more")
        if leader.balancing:
            self.take()
        if leader.answer(demand):
            self._answered = state.sequence

    @property
    def age(self) -> int:
        """Periods between the newest state and the one that the Motor in force answers."""
        return self._current - self._answered

    @property
    def newest(self) -> int:
        """Sequence of the newest Proprioceptor that was published."""
        return self._current

    @property
    def drops(self) -> int:
        """Messages that were lost on the way."""
        return self._subscriber.drops

    def take(self) -> None:
        """Admit or refuse what waits, as much as a period may take; never blocks."""
        for received in self._subscriber.drain(AT_ONCE, TAKING):
            self._consider(received.message, received.origin)

    def wait(self, timeout: float, age: int = 0) -> bool:
        """Wait until the Motor in force answers a state at most ``age`` periods old.

        Returns whether it does; if not within ``timeout`` [s], that is counted, and Motor is silent after several.
        It is silent at once if its publisher is gone: a slow controller is waited for, a dead one is not.
        """
        deadline = time.perf_counter() + timeout
        leader = self.leader
        while leader.motor is None or self.age > age:
            remaining = deadline - time.perf_counter()
            if remaining <= 0.0:
                if leader.motor is not None:
                    self.waits_timed_out += 1
                    self._misses += 1
                    if self._misses >= MISSES_TO_SILENCE:
                        leader.abandon(f"{self._misses} waits of {timeout:g} s for a Motor timed out")
                return False
            received = self._subscriber.receive(timeout=min(remaining, _LOOK_EVERY))
            if received is not None:
                self._consider(received.message, received.origin)
            elif leader.motor is not None and not self._subscriber.publishers:
                leader.abandon("nobody publishes Motor any more")
                return False
        self._misses = 0
        return True

    def listen(self, timeout: float) -> None:
        """Admit what has come, or else the next that comes within ``timeout`` [s]; a miss is not counted.

        For a robot whose time passes by itself: Motor is silent when none has come for the time-out, whatever was
        waited for.
        """
        before = self.leader.admitted
        self.take()
        if self.leader.admitted == before and timeout > 0.0:
            received = self._subscriber.receive(timeout=timeout)
            if received is not None:
                self._consider(received.message, received.origin)

    @property
    def answered(self) -> bool:
        """Whether the Motor in force answers the newest state."""
        return self.leader.motor is not None and self.age <= 0

    def _consider(self, motor: Motor, origin: str) -> None:
        """Admit a Motor, or count and log why not; those that may not lead the robot now are passed over."""
        if not self.leader.hears(motor):
            return
        if reason := self._fault(motor):
            self.refused += 1
            kind = reason.partition(":")[0]
            now = time.monotonic()
            if now - self._logged.get(kind, -_LOG_EVERY) >= _LOG_EVERY:
                self._logged[kind] = now
                _log.warning("Motor from %s refused: %s (%d refused since start)", origin, reason, self.refused)
        elif self.leader.follow(motor, origin):
            self._answered = motor.proprioceptor_sequence
            self._admitted_at = self._time
            self._writer = motor.writer
            self._misses = 0

    def _fault(self, motor: Motor) -> str:
        """Why a Motor is not obeyed; empty if it is."""
        answers = motor.proprioceptor_sequence
        if not self._first:
            return "answers no state: none has been measured yet"
        if not self._first <= answers <= self._current:
            return f"answers no state of this world: {answers}, expected {self._first} to {self._current}"
        if motor.writer < self._writer:
            return f"of an older Motion Manager: began at {motor.writer} ns, the one obeyed at {self._writer} ns"
        if answers < self._answered:
            return f"older than the one in force: answers {answers}, {self._answered} is answered"
        if self.leader.motor is not None and self._current - answers > self._max_age:
            return f"too old: answers {answers}, now is {self._current}, at most {self._max_age} periods are allowed"
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
