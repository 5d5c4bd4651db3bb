"""Command source selection: Motion Manager; balance reflex, if Motor times out during a step; or none.

Without a source the joints hold their position, or stay limp. Then ``comms_manager/stop`` accepts stop requests.
"""

from __future__ import annotations

import contextlib
import json
import logging
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from valor.common import whole_file
from valor.common.behaviors import REFLEX, Behavior, Obstacle, Reaction
from valor.common.messages import BehaviorReply, BehaviorRequest, JointMode, Motor, Proprioceptor
from valor.whole_body.reflex import BalanceReflex

SOFT_STOP, FREEZE, FALL = Behavior.SOFT_STOP, Behavior.FREEZE, Behavior.FALL
"""Behaviors that ``comms_manager/stop`` accepts."""

_log = logging.getLogger("comms_manager")


class CommandArbiter:
    """Selects the active Motor."""

    def __init__(self, reflex: BalanceReflex, latch: BehaviorLatch) -> None:
        self._reflex, self._latch = reflex, latch
        self._state: Proprioceptor | None = None
        self._ordered = ""  # freeze or fall, until a Motion Manager adopts it
        self.motor: Motor | None = None  # active one
        self.admitted = 0  # number of Motors so far, so that a user detects a new ``motor``
        self.abandoned = False  # Motor of the Motion Manager has timed out
        self.balancing = False  # the balance reflex is the source
        self.limp = False  # no source, and the active Motor, which only damps, continues to act

    @property
    def behavior(self) -> str:
        """The robot's behavior, for ``Proprioceptor.motor_behavior``."""
        return REFLEX if self.balancing else self._latch.behavior

    @property
    def silent(self) -> bool:
        """True if there is no command source: joints must hold, or stay ``limp``."""
        return self.abandoned and not self.balancing

    def accepts(self, motor: Motor) -> bool:
        """Return whether a Motor may control the robot now.

        Fall is always accepted; during the reflex also Freeze; after a stop, only the ordered behavior. A Motion
        Manager that yields to the reflex marks its Motors with that behavior, and they are not accepted.
        """
        if motor.behavior in (REFLEX, FALL):
            return motor.behavior == FALL
        if self.balancing:
            return motor.behavior == FREEZE
        return self._ordered in ("", motor.behavior)

    def follow(self, motor: Motor, origin: str) -> bool:
        """Activate a valid, accepted Motor, or pass its request to the reflex; returns whether the Motor is active."""
        if self.balancing:
            if motor.behavior != FALL:
                self._order(FREEZE, origin)
                return False
            self._end_reflex(f"Motor from {origin} makes the robot limp")
        self._ordered = ""
        self._activate(motor, motor.behavior)
        if self.abandoned:
            self.abandoned = self.limp = False
            _log.info("Motor from %s again; it is active", origin)
        return True

    def abandon(self, why: str) -> None:
        """Handle the timeout of Motor; ``why`` is logged."""
        if self.abandoned or self.motor is None or self._state is None:
            return
        self.abandoned = True
        behavior = self._latch.behavior
        if self._reflex.needed(behavior, self._state):
            self.balancing = True
            self._reflex.begin(self.motor)
            _log.warning("%s: in %s, the balance reflex brings the robot to stand", why, behavior)
        else:
            if behavior == FALL and drives(self.motor):  # in the middle of a landing
                self._activate(self._reflex.let_go(self._state, self.motor), FALL)
            self._rest(why)

    def measured(self, state: Proprioceptor) -> None:
        self._state = state

    def answer(self, demand: Reaction) -> bool:
        """Let the reflex, if active, answer the latest state; returns whether it did. ``demand``: of the devices."""
        if not self.balancing or self._state is None:
            return False
        hold = demand is Reaction.HOLD or self._ordered == FREEZE
        try:
            with np.errstate(all="ignore"):  # the reflex checks for values that are not finite
                motor = self._reflex.update(self._state, limp=demand is Reaction.LIMP, hold=hold)
        except Exception:
            # The devices continue after any error of the reflex.
            _log.exception("error in the balance reflex")
            self._end_reflex("an error")
            self._rest("no command source")
            return False
        if self._reflex.limp:
            self._ordered = FALL
        self._activate(motor, FALL if self._reflex.limp else self._latch.behavior)
        if self._reflex.done:
            self._end_reflex(self._reflex.outcome)
            self._rest("the balance reflex has ended")
        return True

    def stop(self, request: BehaviorRequest, origin: str) -> BehaviorReply:
        """Execute a stop request: Fall at once, Freeze and Soft Stop as soon as the robot stays upright.

        The reflex itself is a Soft Stop; for held joints Soft Stop is Freeze. Freeze during a step waits until both
        feet stand.
        """
        limbs = "limbs are frozen by a Motion Manager only" if request.limbs else ""
        if reason := limbs or self._rejection(request.behavior):
            return BehaviorReply(False, self.behavior, reason, Obstacle.CONDITION)
        if request.behavior == FALL:
            self._make_limp(origin)
            reason = "limp, by the Comms Manager"
        elif self.balancing:
            if request.behavior == FREEZE:
                self._order(FREEZE, origin)
            reason = "the balance reflex brings the robot to stand, and the joints are held then"
        else:
            self._order(FREEZE, origin)
            self._latch.update(FREEZE)
            self.limp = False
            reason = "held by the Comms Manager"
        return BehaviorReply(True, self.behavior, reason, Obstacle.NONE)

    def _rejection(self, behavior: str) -> str:
        if behavior not in (SOFT_STOP, FREEZE, FALL):
            return f"unknown behavior {behavior[:64]!r}; expected one of {SOFT_STOP}, {FREEZE}, {FALL}"
        if self.motor is not None and not self.abandoned:
            return "a Motion Manager controls the robot; request the behavior there"
        if self._state is None or (self.motor is None and behavior != FALL):
            return "no Motion Manager has controlled the robot yet"
        if self.limp and behavior == SOFT_STOP:
            return "the robot is limp"
        return ""

    def _order(self, behavior: str, origin: str) -> None:
        """Accept only Motors of a behavior, until a Motion Manager adopts it."""
        if self._ordered != behavior:
            self._ordered = behavior
            _log.warning("%s, for %s", behavior, origin)

    def _make_limp(self, origin: str) -> None:
        assert self._state is not None
        if self.balancing:
            self._end_reflex(f"{origin} makes the robot limp")
        if self._ordered != FALL or not self.limp:
            self._order(FALL, origin)
            self._activate(self._reflex.let_go(self._state, self.motor), FALL)
            self.abandoned = True
            self._rest(f"{FALL}, for {origin}")

    def _activate(self, motor: Motor, behavior: str) -> None:
        self.motor = motor
        self.admitted += 1
        self._latch.update(behavior)

    def _end_reflex(self, why: str) -> None:
        self.balancing = False
        if self._ordered == FREEZE:
            self._latch.update(FREEZE)
        _log.warning("the balance reflex has ended: %s", why)

    def _rest(self, why: str) -> None:
        """End the command source: joints are held, or stay limp."""
        self.limp = self.motor is not None and not drives(self.motor)
        _log.warning("%s: the joints %s", why, "stay limp" if self.limp else "are held")


def drives(motor: Motor) -> bool:
    """Return whether a Motor can move a joint at rest: anything but damping."""
    servo = motor.mode == JointMode.POSITION
    spring = (motor.mode == JointMode.IMPEDANCE) & (motor.stiffness > 0.0)
    force = (motor.mode != JointMode.OFF) & (motor.effort != 0.0)
    return bool((servo | spring | force).any())


class BehaviorLatch:
    """Stores the behavior of the latest Motor across restarts of this process, until the next ``up``."""

    def __init__(self, file: Path, epoch: int) -> None:
        """Load ``file`` of the instance's folder; content with another epoch than that of ``up`` is ignored."""
        self._file, self._epoch = file, epoch
        self._disk = ThreadPoolExecutor(1, "latch")  # a slow disk must not delay the robot's loop
        self.behavior = self._read()  # of the latest Motor since ``up``; an empty string before the first

    def update(self, behavior: str) -> None:
        if behavior != self.behavior:
            self.behavior = behavior
            self._disk.submit(self._write, behavior)

    def close(self) -> None:
        self._disk.shutdown()

    def _read(self) -> str:
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
            written = json.loads(self._file.read_text())
            if written["epoch"] == self._epoch:
                return str(written["behavior"])
        return ""

    def _write(self, behavior: str) -> None:
        try:
            whole_file.write(self._file, json.dumps({"epoch": self._epoch, "behavior": behavior}))
        except OSError as error:
            _log.warning("%s: %s; the behavior %s is lost at a restart", self._file, error.strerror, behavior)
