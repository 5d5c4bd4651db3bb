"""Which Motor the devices obey: the newest sound one, until Motor is silent; the reflex' own, where a robot stepped."""

from __future__ import annotations

import logging
import math
import time

import bifrost
from valor.common.messages import REFLEX, JointMode, Motor, Proprioceptor
from valor.common.robot import RobotDescription
from valor.comms_manager.latch import BehaviorLatch
from valor.comms_manager.reflex import Reflex

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
        motor: the one in force; None before the first.
        admitted: how many were admitted, so that a user sees whether ``motor`` is new.
        abandoned: Motor came, and then no more.
        silent: nor does the reflex make any. The joints are to be held where they are, or left ``limp``.
        limp: the last Motor asked for no force but damping: it goes on acting while Motor is silent.
        refused: how many were refused.
        waits_timed_out: how often ``wait`` gave up.
    """

    def __init__(
        self,
        subscriber: bifrost.Subscriber[Motor],
        robot: RobotDescription,
        latch: BehaviorLatch,
        reflex: Reflex,
    ) -> None:
        """``latch`` is told the behavior of every Motor that is admitted; ``reflex`` leads a robot left stepping."""
        self._subscriber = subscriber
        self._latch, self._reflex = latch, reflex
        self._state: Proprioceptor | None = None
        self._length = len(robot.joints)
        self._max_age = round(COMMAND_TIMEOUT * robot.tables.control_rate)
        self._first = self._current = 0
        self._answered = 0
        self._time = self._admitted_at = 0
        self._writer = 0
        self._misses = 0
        self._logged: dict[str, float] = {}
        self.motor: Motor | None = None
        self.admitted = 0
        self.abandoned = self.limp = False
        self.refused = 0
        self.waits_timed_out = 0

    def measured(self, state: Proprioceptor, demand: str) -> None:
        """A Proprioceptor was published: what is admitted from now on answers it at the newest.

        Args:
            state: it.
            demand: of the devices, as ``DeviceStatus.reaction`` has it.
        """
        self._first = self._first or state.sequence
        self._state, self._current, self._time = state, state.sequence, state.time
        if self.motor is not None and not self.abandoned:
            if self._time - self._admitted_at > COMMAND_TIMEOUT * 1e9:
                self._fall_silent(f"no Motor for {COMMAND_TIMEOUT:g} s of robot time")
            elif self.age > ABSENCE and not self._subscriber.publishers:
                self._fall_silent("nobody publishes Motor any more")
        if self._reflex.active:
            self.take()
        if self._reflex.active:
            self._react(state, demand)

    @property
    def silent(self) -> bool:
        """Nobody drives the joints."""
        return self.abandoned and not self._reflex.active

    @property
    def age(self) -> int:
        """Periods between the newest state and the one that the Motor in force answers."""
        return self._current - self._answered

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
        while self.motor is None or self.age > age:
            remaining = deadline - time.perf_counter()
            if remaining <= 0.0:
                if self.motor is not None:
                    self.waits_timed_out += 1
                    self._misses += 1
                    if self._misses >= MISSES_TO_SILENCE:
                        self._fall_silent(f"{self._misses} waits of {timeout:g} s for a Motor timed out")
                return False
            received = self._subscriber.receive(timeout=min(remaining, _LOOK_EVERY))
            if received is not None:
                self._consider(received.message, received.origin)
            elif self.motor is not None and not self._subscriber.publishers:
                self._fall_silent("nobody publishes Motor any more")
                return False
        self._misses = 0
        return True

    def listen(self, timeout: float) -> None:
        """Admit what has come, or else the next that comes within ``timeout`` [s]; a miss is not counted.

        For a robot whose time passes by itself: Motor is silent when none has come for the time-out, whatever was
        waited for.
        """
        before = self.admitted
        self.take()
        if self.admitted == before and timeout > 0.0:
            received = self._subscriber.receive(timeout=timeout)
            if received is not None:
                self._consider(received.message, received.origin)

    @property
    def answered(self) -> bool:
        """Whether the Motor in force answers the newest state."""
        return self.motor is not None and self.age <= 0

    def _consider(self, motor: Motor, origin: str) -> None:
        """Admit a Motor, or count and log why not; those of one that stands aside for the reflex are passed over."""
        if motor.behavior == REFLEX or (self._reflex.active and not self._reflex.yields_to(motor)):
            return
        if reason := self._fault(motor):
            self.refused += 1
            kind = reason.partition(":")[0]
            now = time.monotonic()
            if now - self._logged.get(kind, -_LOG_EVERY) >= _LOG_EVERY:
                self._logged[kind] = now
                _log.warning("Motor from %s refused: %s (%d refused since start)", origin, reason, self.refused)
            return
        if self._reflex.active:
            self._reflex.leave(f"Motor from {origin} lets the robot go")
        self.motor = motor
        self.admitted += 1
        self._answered = motor.proprioceptor_sequence
        self._admitted_at = self._time
        self._writer = motor.writer
        self._latch.update(motor.behavior)
        if self.abandoned:
            self.abandoned = self.limp = False
            self._misses = 0
            _log.info("Motor from %s again; the joints obey it", origin)

    def _fault(self, motor: Motor) -> str:
        """Why a Motor is not obeyed; empty if it is."""
        answers = motor.proprioceptor_sequence
        if not self._first <= answers <= self._current:
            return f"answers no state of this world: {answers}, expected {self._first} to {self._current}"
        if motor.writer < self._writer:
            return f"of an older Motion Manager: began at {motor.writer} ns, the one obeyed at {self._writer} ns"
        if answers < self._answered:
            return f"older than the one in force: answers {answers}, {self._answered} is answered"
        if self.motor is not None and self._current - answers > self._max_age:
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

    def _fall_silent(self, why: str) -> None:
        if self.abandoned or self.motor is None or self._state is None:
            return
        self.abandoned = True
        if self._reflex.begin(self._latch.behavior, self.motor, self._state):
            _log.warning("%s: the robot, left in %s, is brought to stand", why, self._latch.behavior)
        else:
            self._rest(why)

    def _react(self, state: Proprioceptor, demand: str) -> None:
        """The reflex answers a state, in place of the Motion Manager."""
        motor = self._reflex.update(state, demand)
        if motor is not None:
            self.motor = motor
            self.admitted += 1
            self._answered = state.sequence
            if motor.behavior != REFLEX:
                self._latch.update(motor.behavior)
        if not self._reflex.active:
            self._rest("the balance reflex has ended")

    def _rest(self, why: str) -> None:
        """Nobody drives the joints from now on."""
        self.limp = self.motor is not None and not drives(self.motor)
        _log.warning("%s: the joints %s", why, "stay limp" if self.limp else "are held where they are")


def drives(motor: Motor) -> bool:
    """Whether a Motor can move a joint that is at rest: all but damping, and motors that are off."""
    servo = motor.mode == JointMode.POSITION
    spring = (motor.mode == JointMode.IMPEDANCE) & (motor.stiffness > 0.0)
    force = (motor.mode != JointMode.OFF) & (motor.effort != 0.0)
    return bool((servo | spring | force).any())
