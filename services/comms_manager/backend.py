"""Interface between the main loop and its devices, simulated or real."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

from valor.common.behaviors import Reaction
from valor.common.messages import Proprioceptor
from valor.comms_manager.batteries import BatteryMonitor
from valor.comms_manager.commands import Commands


class Backend(ABC):
    """The robot's devices and their time."""

    waits_for_motor = True  # robot time starts with the first Motor; otherwise it passes independently
    demand = Reaction.KEEP_BALANCE  # reaction that the condition of the devices requires
    batteries: Sequence[BatteryMonitor] = ()  # one, if the robot has batteries

    @property
    def paused(self) -> bool:
        """True if robot time is paused on request."""
        return False

    def resume(self) -> None:  # noqa: B027  # time of a real robot always passes
        """Resume robot time, if paused."""

    @property
    @abstractmethod
    def clock(self) -> str:
        """Name of the clock, for ``ClockStatus.mode``."""

    @property
    @abstractmethod
    def slip(self) -> float:
        """Wall-clock time that robot time has lost since the first Motor [s]."""

    @property
    def note(self) -> str:
        """Status note about the clock; an empty string without one."""
        return ""

    @abstractmethod
    def advance(self, commands: Commands) -> float:
        """Apply ``commands`` and advance the devices by the control period; returns the time spent waiting [s]."""

    @abstractmethod
    def measure(self, sequence: int) -> Proprioceptor:
        """The state of all devices at the end of the period, as the Proprioceptor of that sequence."""

    @abstractmethod
    def attend(self) -> None:
        """Serve requests and publish the backend's own topics."""

    @abstractmethod
    def pace(self) -> None:
        """Wait until the end of the period on the wall clock."""

    @abstractmethod
    def close(self) -> None:
        """Close the devices."""
