"""Controller managers (thesis section 3.5): each runs the active ones of its controllers.

There are three: the control mode manager runs the control mode controller, whose table says which controllers the
joint manager and the robot manager may run.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from typing import Protocol

from valor.common.errors import ConfigurationError
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface

_log = logging.getLogger("controller_manager")


class Controller(Protocol):
    """What a manager runs."""

    @property
    def name(self) -> str:
        """Unique among all controllers."""

    @property
    def type(self) -> str:
        """As ros2_control names plugins."""

    def start(self, hw: ValorEscherHWInterface) -> None:
        """Become active."""

    def stop(self, hw: ValorEscherHWInterface, reason: str) -> None:
        """Become inactive; ``reason`` is for whoever waits for a goal."""

    def update(self, hw: ValorEscherHWInterface) -> None:
        """One cycle. Called whether active or not, for requests must be answered."""


class Onlooker:
    """A controller that leads nothing: it says how things are while it is active.

    Attributes:
        active: chosen by the control mode.
    """

    active = False

    def start(self, hw: ValorEscherHWInterface) -> None:
        """Be active."""
        self.active = True

    def stop(self, hw: ValorEscherHWInterface, reason: str) -> None:
        """Be inactive."""
        self.active = False

    def update(self, hw: ValorEscherHWInterface) -> None:
        """Nothing is led from here."""


class ControllerManager:
    """Controllers by name, which of them the control mode allows, and which are active.

    Attributes:
        controllers: by name.
        active: names of the active ones, sorted; a new object whenever they change.
        switches: how often the active ones changed.
    """

    def __init__(self, name: str, controllers: Iterable[Controller]) -> None:
        self.name = name
        self.controllers: dict[str, Controller] = {controller.name: controller for controller in controllers}
        self.switches = 0
        self._mode = ""
        self._allowed: frozenset[str] = frozenset()
        self.active: tuple[str, ...] = ()

    def check(self, names: Sequence[str], where: str) -> None:
        """Whether all controllers named exist.

        Raises:
            ConfigurationError: one does not; ``where`` says who names it.
        """
        if unknown := [name for name in names if name not in self.controllers]:
            known = ", ".join(self.controllers) or "none"
            raise ConfigurationError(f"{where}: unknown controller {unknown[0]!r}; the {self.name} manager has {known}")

    def enter(
        self, mode: str, names: Sequence[str], hw: ValorEscherHWInterface, reason: str, *, anew: bool = False
    ) -> None:
        """Make exactly these active when a control mode begins; in the mode others may switch among them.

        Those that stay go on undisturbed, unless all are to start ``anew``.
        """
        if mode == self._mode and not anew:
            return
        self._mode = mode
        self._allowed = frozenset(names)
        leaving = [name for name in self.active if anew or name not in self._allowed]
        self.apply(leaving, [name for name in names if anew or name not in self.active], hw, reason)

    def allows(self, name: str) -> bool:
        """Whether a controller may be active in the present mode."""
        return name in self._allowed

    def apply(self, leaving: Sequence[str], coming: Sequence[str], hw: ValorEscherHWInterface, reason: str) -> None:
        """Stop controllers that are active, then start others, within one cycle."""
        if not (leaving or coming):
            return
        for name in leaving:
            self.controllers[name].stop(hw, reason)
        for name in coming:
            self.controllers[name].start(hw)
        stay = [name for name in self.active if name not in leaving]
        self.active = tuple(sorted((*stay, *coming)))
        self.switches += 1
        _log.info("%s controllers: %s (%s)", self.name, ", ".join(self.active) or "none", reason)

    def update(self, hw: ValorEscherHWInterface) -> None:
        """One cycle of each."""
        for controller in self.controllers.values():
            controller.update(hw)
