"""The table of control modes, read from ``control_modes.yaml``."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Literal, Self

from msgspec import structs

from valor.common.behaviors import MANIPULATING
from valor.common.table import Table, TableError, read

FILE = Path(__file__).with_name("control_modes.yaml")


class ControlMode(Table, kw_only=True):
    """One mode; the meaning of each key stands in the file."""

    bdi: int
    upper_body: Literal[-1, 0, 1]
    switch: Literal["immediate", "on_feedback", "hard_reset"]
    motion: tuple[str, str] | None
    joint_controllers: tuple[str, ...]
    robot_controllers: tuple[str, ...] = ()
    to: frozenset[str]
    preempts: bool = False
    when_done: str | None = None
    lacking: str = ""  # not in the file: what a robot has not that the mode is for


class ControlModeTable(Table):
    """The whole file."""

    sets: dict[str, tuple[str, ...]]  # named only to be referred to within the file
    modes: dict[str, ControlMode]
    behaviors: dict[str, str]
    emergency_stop: tuple[str, ...]

    def __post_init__(self) -> None:
        known = set(self.modes)
        for name, mode in self.modes.items():
            if unknown := (set(mode.to) | {mode.when_done or name}) - known:
                raise TableError(("modes", name), f"unknown modes {sorted(unknown)}; expected of {sorted(known)}")
            if unknown := set(mode.motion or ()) - set(self.behaviors):
                raise TableError(("modes", name, "motion"), f"unknown behaviors {sorted(unknown)}")
        for key, modes in (("behaviors", self.behaviors.values()), ("emergency_stop", self.emergency_stop)):
            if unknown := set(modes) - known:
                raise TableError((key,), f"unknown modes {sorted(unknown)}; expected of {sorted(known)}")

    @classmethod
    def load(cls, file: Path = FILE) -> ControlModeTable:
        """Read the table.

        Raises:
            ConfigurationError: the file or a key is missing or wrong.
        """
        return read(cls, file)

    def without(self, controllers: Collection[str], lacking: str) -> Self:
        """For a robot that lacks the limbs of some joint controllers.

        Args:
            controllers: that are not made for it.
            lacking: why it is not brought into modes that manipulate; empty: it is.
        """
        made = {
            name: structs.replace(
                mode,
                joint_controllers=tuple(each for each in mode.joint_controllers if each not in controllers),
                lacking=lacking if mode.motion and mode.motion[1] in MANIPULATING else "",
            )
            for name, mode in self.modes.items()
        }
        return structs.replace(self, modes=made)

    def fits(self, mode: str, behavior: str) -> bool:
        """Whether the Motion System in ``behavior`` is what ``mode`` stands for."""
        motion = self.modes[mode].motion
        return (motion is not None and motion[1] == behavior) or self.behaviors.get(behavior) == mode

    def running(self, controller: str) -> list[str]:
        """The modes in which a joint controller is active."""
        return [name for name, mode in self.modes.items() if controller in mode.joint_controllers]
