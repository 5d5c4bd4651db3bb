"""When the balance reflex leads the robot: Motor has fallen silent in the middle of a step."""

from __future__ import annotations

import logging

import numpy as np

from valor.common.messages import Motor, Proprioceptor
from valor.common.robot import RobotDescription
from valor.motion_manager.reflex import BalanceReflex

_log = logging.getLogger("comms_manager")


class Reflex:
    """Makes the Motors of a robot that was left behind stepping, until it stands.

    Attributes:
        active: it leads the robot; Motors of others are passed over meanwhile.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self._balance = BalanceReflex(robot)
        self.active = False

    def begin(self, behavior: str, last: Motor, state: Proprioceptor) -> bool:
        """Take over a robot left in ``behavior``, if it cannot simply be held; returns whether."""
        self.active = self._balance.needed(behavior, state)
        if self.active:
            self._balance.begin(last)
        return self.active

    def update(self, state: Proprioceptor, demand: str) -> Motor | None:
        """The Motor that answers ``state``; None: an error of ours, nobody leads the robot any more.

        Args:
            state: newest.
            demand: of the devices, as ``DeviceStatus.reaction`` has it.
        """
        try:
            with np.errstate(all="ignore"):  # what is not finite is looked for where it matters
                motor = self._balance.update(state, limp=demand == "limp", hold=demand == "hold")
        except Exception:
            # Whatever is wrong with it, the devices go on.
            _log.exception("error in the balance reflex")
            self.active = False
            return None
        if self._balance.done:
            self.active = False
            _log.warning("the balance reflex has ended: %s", self._balance.outcome)
        return motor

    def yields_to(self, motor: Motor) -> bool:
        """Whether somebody else's Motor goes before its own: one that lets the robot go."""
        return self._balance.yields_to(motor)

    def leave(self, why: str) -> None:
        """Somebody to whom it yields has the robot."""
        self.active = False
        _log.warning("the balance reflex has ended: %s", why)
