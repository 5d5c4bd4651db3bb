"""Switching controllers by hand, within what the control mode allows.

The meaning is that of ros2_control's ``switch_controller`` (Jazzy). The control mode stands above it: its table says
which controllers may be active, entering a mode makes all of them active, and in the mode clients switch among them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum

from valor.valor_ros_controller.controller_manager import ControllerManager
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface


class Strictness(IntEnum):
    """As ``controller_manager_msgs/srv/SwitchController`` numbers them."""

    BEST_EFFORT = 1
    STRICT = 2
    AUTO = 3
    FORCE_AUTO = 4


@dataclass(frozen=True)
class SwitchAnswer:
    """Whether controllers were switched as asked, and what was not."""

    ok: bool
    message: str


@dataclass
class _Plan:
    """What of a request is possible, and why the rest is not."""

    asked: int
    names: list[str] = field(default_factory=list)
    refusals: list[str] = field(default_factory=list)

    @property
    def failed(self) -> bool:
        """All that was asked for is refused."""
        return self.asked > 0 and len(self.refusals) == self.asked


class ControllerSwitch:
    """Answers requests to activate and deactivate controllers. Update thread.

    Attributes:
        managers: all of them, that of the control modes first.
    """

    def __init__(self, managers: Sequence[ControllerManager], hw: ValorEscherHWInterface) -> None:
        """Put it over the managers that may be switched; the first of ``managers`` is not to be: it has the modes."""
        self.managers = tuple(managers)
        self._modes, *self._managers = managers
        self._hw = hw

    def switch(self, activate: Sequence[str], deactivate: Sequence[str], strictness: int) -> SwitchAnswer:
        """Do what is asked for, all in this cycle.

        Args:
            activate: names.
            deactivate: names; who is in both starts anew.
            strictness: STRICT: all or nothing. BEST_EFFORT, and all that amounts to it without chains of controllers
                (AUTO, FORCE_AUTO, 0): what is possible, which is no success if nothing of a list is.
        """
        if strictness not in (0, *Strictness):
            return SwitchAnswer(False, f"strictness {strictness}; expected 1 (BEST_EFFORT) or 2 (STRICT)")
        strict = strictness == Strictness.STRICT
        leaving, coming = self._leaving(deactivate, strict), self._coming(activate, deactivate, strict)
        refusals = leaving.refusals + coming.refusals
        if strict and refusals:
            return SwitchAnswer(False, "; ".join(refusals))
        for manager in self._managers:
            names = manager.controllers
            manager.apply(
                [name for name in leaving.names if name in names],
                [name for name in coming.names if name in names],
                self._hw,
                f"switched by a client in {self._hw.situation}",
            )
        return SwitchAnswer(not (leaving.failed or coming.failed), "; ".join(refusals))

    def _leaving(self, deactivate: Sequence[str], strict: bool) -> _Plan:
        plan = _Plan(len(set(deactivate)))
        for name in dict.fromkeys(deactivate):
            if name in self._modes.controllers:
                plan.refusals.append(f"{name} has the control modes and is always active")
            elif (manager := self._manager(name)) is None:
                plan.refusals.append(self._unknown(name))
            elif name in manager.active:
                plan.names.append(name)
            elif strict:
                plan.refusals.append(f"{name} is not active")
        return plan

    def _coming(self, activate: Sequence[str], deactivate: Sequence[str], strict: bool) -> _Plan:
        plan = _Plan(len(set(activate)))
        for name in dict.fromkeys(activate):
            if name in self._modes.controllers or ((manager := self._manager(name)) and name in manager.active):
                if name in deactivate and name not in self._modes.controllers:
                    plan.names.append(name)
                elif strict:
                    plan.refusals.append(f"{name} is already active")
            elif manager is None:
                plan.refusals.append(self._unknown(name))
            elif not manager.allows(name):
                plan.refusals.append(f"{name} may not be active: {self._hw.situation}")
            else:
                plan.names.append(name)
        return plan

    def _manager(self, name: str) -> ControllerManager | None:
        return next((manager for manager in self._managers if name in manager.controllers), None)

    def _unknown(self, name: str) -> str:
        known = ", ".join(name for manager in self.managers for name in manager.controllers)
        return f"no controller is named {name!r}; there are {known}"
