"""The seam between the main loop and what it runs on: simulated devices or real ones."""

from __future__ import annotations

from abc import ABC, abstractmethod

from valor.common.behaviors import Reaction
from valor.common.messages import Proprioceptor
from valor.comms_manager.commands import Commands


class Backend(ABC):
    """The robot's devices as the main loop sees them, and how their time passes.

    Attributes:
        waits_for_motor: robot time begins with the first Motor; otherwise it passes by itself.
        demand: what the devices' condition demands of the robot.
    """

    waits_for_motor = True
    demand = Reaction.KEEP_BALANCE

    @property
    def paused(self) -> bool:
        """Whether robot time stands, because somebody wants it to."""
        return False

    def resume(self) -> None:  # noqa: B027  # of a real robot time always passes
        """Let robot time pass, if it was paused."""

    @property
    @abstractmethod
    def clock(self) -> str:
        """Name of the clock, for ``ClockStatus.mode``."""

    @property
    @abstractmethod
    def slip(self) -> float:
        """Robot time lost against the wall since the first Motor [s]."""

    @property
    def remark(self) -> str:
        """What a person is to know of its clock, while all is well otherwise; empty: nothing."""
        return ""

    @abstractmethod
    def advance(self, commands: Commands) -> float:
        """Bring the devices to the end of the control period, obeying ``commands``.

        Takes commands in when its clock says so. Returns the time spent waiting [s].
        """

    @abstractmethod
    def measure(self, sequence: int) -> Proprioceptor:
        """The state of all devices at the end of the period, as the Proprioceptor of that sequence."""

    @abstractmethod
    def attend(self) -> None:
        """Do what is due beside the devices: answer requests, publish topics of its own."""

    @abstractmethod
    def pace(self) -> None:
        """Wait until the end of the period is due on the wall."""

    @abstractmethod
    def close(self) -> None:
        """Give back the devices."""
