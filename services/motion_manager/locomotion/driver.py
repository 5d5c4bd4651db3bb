"""What a driver is, of which each state of the Locomotion FSM has one, and how it leaves the joints to the next."""

from __future__ import annotations

from abc import ABC, abstractmethod
from enum import Enum, auto
from typing import ClassVar

from valor.common.behaviors import Locomotion
from valor.whole_body.state import RobotState

JUST_BEGUN = "stand_prep has just begun"


class Leaves(Enum):
    """How a driver leaves the joints to servos that are to hold them."""

    LIMP = auto()  # where they lie, without effort
    HELD = auto()  # by their servos already
    LED = auto()  # with the efforts that were commanded last


class Driver(ABC):
    """Drives the joints while the Locomotion FSM is in its state. Times are robot time [s]."""

    leaves: ClassVar[Leaves] = Leaves.LED

    @abstractmethod
    def enter(self, before: Driver | None, state: RobotState, now: float) -> None:
        """Take the joints over; ``before`` had them in the last period (None: nobody whom we know)."""

    @abstractmethod
    def drive(self, state: RobotState, now: float, dt: float) -> None:
        """Fill the command of this period."""

    def leave(self, to: Locomotion) -> None:  # noqa: B027 (most have nothing to end)
        """End what would make no sense in the state to come."""

    def proceed(self, state: RobotState, now: float) -> None:  # noqa: B027 (most do not)
        """See whether the state ends by itself; before the others look at the state machines in a period."""

    def not_prepared(self, state: RobotState, now: float) -> str:
        """Why the nominal posture is not reached; an empty text: it is."""
        return JUST_BEGUN
