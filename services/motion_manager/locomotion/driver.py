"""Drivers: one for each state of the Locomotion FSM, in control of the joints while it is active."""

from __future__ import annotations

from abc import ABC, abstractmethod
from enum import Enum, auto
from typing import TYPE_CHECKING, ClassVar

from valor.common.behaviors import Locomotion
from valor.control.state import RobotState
from valor.motion_manager.discovery import classes

if TYPE_CHECKING:
    from valor.motion_manager.components import Components

JUST_STARTED = "stand_prep has just started"


class Release(Enum):
    """State of the joints when a driver ends, for servos that are to hold them."""

    LIMP = auto()  # without effort
    HELD = auto()  # held by their servos
    CONTROLLED = auto()  # with the efforts of the last command


class Driver(ABC):
    """Controls the joints in some states of the Locomotion FSM. Subclasses in this package are found automatically."""

    states: ClassVar[tuple[Locomotion, ...]] = ()  # each gets an instance; empty for base classes
    release: ClassVar[Release] = Release.CONTROLLED  # state of the joints at the end

    def __init__(self, components: Components) -> None:
        self.components = components

    @abstractmethod
    def enter(self, before: Driver | None, state: RobotState, now: float) -> None:
        """Start at robot time ``now`` [s]; ``before`` was active in the last period, None if unknown."""

    @abstractmethod
    def drive(self, state: RobotState, now: float, dt: float) -> None:
        """Fill the command of this period, at robot time ``now``, ``dt`` after the last one [s]."""

    def leave(self, to: Locomotion) -> None:  # noqa: B027 (most have nothing to end)
        """End what does not fit the next state."""

    def proceed(self, state: RobotState, now: float) -> None:  # noqa: B027 (most do not)
        """End the state if it is complete; runs before the other checks of a period."""

    def not_prepared(self, state: RobotState, now: float) -> str:
        """Reason why the nominal posture is not reached; empty if it is."""
        return JUST_STARTED


class Drivers:
    """Drivers of all states, and the active one."""

    def __init__(self, components: Components) -> None:
        self._fsm = components.fsm
        found = classes(__name__.rpartition(".")[0], Driver)
        self._drivers: dict[Locomotion, Driver] = {
            state: driver(components) for driver in found for state in driver.states
        }
        self.current: Driver | None = None  # of the last period; None before the first, and after ``reset_driver``

    def of(self, locomotion: Locomotion) -> Driver:
        """The driver of a state."""
        return self._drivers[locomotion]

    def proceed(self, state: RobotState, now: float) -> None:
        """Let the active driver end its state."""
        if self.current is self.of(self._fsm.locomotion):
            self.current.proceed(state, now)

    def change(self, state: RobotState, now: float) -> None:
        """Change the driver if the state of the Locomotion FSM changed since the last period."""
        before, self.current = self.current, self.of(self._fsm.locomotion)
        if self.current is before:
            return
        if before is not None:
            before.leave(self._fsm.locomotion)
        self.current.enter(before, state, now)

    def drive(self, state: RobotState, now: float, dt: float) -> None:
        """Fill the command of this period, after ``change``."""
        assert self.current is not None
        self.current.drive(state, now, dt)

    def reset_driver(self, to: Locomotion) -> None:
        """Leave the active driver; the next one starts from the measured joint positions."""
        if self.current is not None:
            self.current.leave(to)
        self.current = None

    def go_limp(self) -> None:
        """Change to the driver of Fall without a valid robot state."""
        self.current = self.of(Locomotion.FALL)

    def not_prepared(self, state: RobotState, now: float) -> str:
        """Reason why the nominal posture is not reached; empty if it is."""
        return self.current.not_prepared(state, now) if self.current else JUST_STARTED
