"""Who leads the robot: a Motion Manager, the balance reflex where that one fell silent within a step, or nobody.

Where nobody does, the joints are held where they are, or stay limp. Who wants the robot stopped while no Motion Manager
can do it, asks here (``comms_manager/stop``).
"""

from __future__ import annotations

import logging

import numpy as np

from valor.common.behaviors import REFLEX, Behavior, Obstacle, Reaction
from valor.common.messages import BehaviorReply, BehaviorRequest, JointMode, Motor, Proprioceptor
from valor.comms_manager.latch import BehaviorLatch
from valor.whole_body.reflex import BalanceReflex

SOFT_STOP, FREEZE, FALL = Behavior.SOFT_STOP, Behavior.FREEZE, Behavior.FALL
"""What may be asked for here."""

_log = logging.getLogger("comms_manager")


class Leader:
    """Whose Motor is in force.

    Attributes:
        motor: the one in force; None before the first.
        admitted: how many have been, so that a user sees whether ``motor`` is new.
        abandoned: a Motion Manager led the robot, and does no more.
        balancing: the reflex leads it.
        limp: nobody drives the joints, and the Motor in force asks for nothing but damping: it goes on acting.
    """

    def __init__(self, reflex: BalanceReflex, latch: BehaviorLatch) -> None:
        """``latch`` is told every behavior that the robot is in."""
        self._reflex, self._latch = reflex, latch
        self._state: Proprioceptor | None = None
        self._ordered = ""  # freeze or fall, until a Motion Manager has taken it on
        self.motor: Motor | None = None
        self.admitted = 0
        self.abandoned = self.balancing = self.limp = False

    @property
    def behavior(self) -> str:
        """That the robot is in, for ``Proprioceptor.motor_behavior``."""
        return REFLEX if self.balancing else self._latch.behavior

    @property
    def silent(self) -> bool:
        """Nobody drives the joints: they are to be held where they are, or left ``limp``."""
        return self.abandoned and not self.balancing

    # --- a Motion Manager's Motors --------------------------------------------------------------------------------

    def hears(self, motor: Motor) -> bool:
        """Whether a Motor may lead the robot now; a Motion Manager that stands aside for the reflex says so in its own.

        What lets the robot go is always heard. While the reflex leads, Freeze is, too; and after an order, whoever has
        taken it on.
        """
        if motor.behavior in (REFLEX, FALL):
            return motor.behavior == FALL
        if self.balancing:
            return motor.behavior == FREEZE
        return self._ordered in ("", motor.behavior)

    def follow(self, motor: Motor, origin: str) -> bool:
        """Obey a sound Motor that is heard, or note what it asks of the reflex; returns whether it is in force."""
        if self.balancing:
            if motor.behavior != FALL:
                self._order(FREEZE, origin)
                return False
            self._end_reflex(f"Motor from {origin} lets the robot go")
        self._ordered = ""
        self._take(motor, motor.behavior)
        if self.abandoned:
            self.abandoned = self.limp = False
            _log.info("Motor from %s again; the joints obey it", origin)
        return True

    def abandon(self, why: str) -> None:
        """No Motor comes any more."""
        if self.abandoned or self.motor is None or self._state is None:
            return
        self.abandoned = True
        behavior = self._latch.behavior
        if self._reflex.needed(behavior, self._state):
            self.balancing = True
            self._reflex.begin(self.motor)
            _log.warning("%s: the robot, left in %s, is brought to stand", why, behavior)
        else:
            self._rest(why)

    # --- without one ----------------------------------------------------------------------------------------------

    def measured(self, state: Proprioceptor) -> None:
        """Take note of the newest state."""
        self._state = state

    def answer(self, demand: Reaction) -> bool:
        """Have the reflex answer the newest state, if it leads; returns whether there is a Motor of it.

        Args:
            demand: of the devices.
        """
        if not self.balancing or self._state is None:
            return False
        hold = demand is Reaction.HOLD or self._ordered == FREEZE
        try:
            with np.errstate(all="ignore"):  # what is not finite is looked for where it matters
                motor = self._reflex.update(self._state, limp=demand is Reaction.LIMP, hold=hold)
        except Exception:
            # Whatever is wrong with it, the devices go on.
            _log.exception("error in the balance reflex")
            self._end_reflex("an error")
            self._rest("nobody leads the robot")
            return False
        if self._reflex.limp:
            self._ordered = FALL
        self._take(motor, FALL if self._reflex.limp else self._latch.behavior)
        if self._reflex.done:
            self._end_reflex(self._reflex.outcome)
            self._rest("the balance reflex has ended")
        return True

    def stop(self, request: BehaviorRequest, origin: str) -> BehaviorReply:
        """Obey who wants the robot stopped: Fall at once, Freeze and Soft Stop as soon as nothing falls by it.

        Soft Stop is what the reflex does; of joints that are held it is Freeze. Freeze in the middle of a step waits
        until both feet stand.
        """
        if refusal := self._refusal(request.behavior):
            return BehaviorReply(False, self.behavior, refusal, Obstacle.CONDITION)
        if request.behavior == FALL:
            self._let_go(origin)
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

    def _refusal(self, wanted: str) -> str:
        """Why a request is not obeyed; empty if it is."""
        if wanted not in (SOFT_STOP, FREEZE, FALL):
            return f"unknown behavior {wanted[:64]!r}; expected one of {SOFT_STOP}, {FREEZE}, {FALL}"
        if self.motor is not None and not self.abandoned:
            return "a Motion Manager leads the robot, and is to be asked"
        if self._state is None or (self.motor is None and wanted != FALL):
            return "nobody has led the robot yet"
        if self.limp and wanted == SOFT_STOP:
            return "the robot is limp"
        return ""

    def _order(self, behavior: str, origin: str) -> None:
        """Until a Motion Manager has taken it on, no other Motor is obeyed."""
        if self._ordered != behavior:
            self._ordered = behavior
            _log.warning("%s, for %s", behavior, origin)

    def _let_go(self, origin: str) -> None:
        assert self._state is not None
        if self.balancing:
            self._end_reflex(f"{origin} lets the robot go")
        if self._ordered != FALL or not self.limp:
            self._order(FALL, origin)
            self._take(self._reflex.let_go(self._state, self.motor), FALL)
            self.abandoned = True
            self._rest(f"{FALL}, for {origin}")

    def _take(self, motor: Motor, behavior: str) -> None:
        self.motor = motor
        self.admitted += 1
        self._latch.update(behavior)

    def _end_reflex(self, why: str) -> None:
        self.balancing = False
        if self._ordered == FREEZE:
            self._latch.update(FREEZE)
        _log.warning("the balance reflex has ended: %s", why)

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
