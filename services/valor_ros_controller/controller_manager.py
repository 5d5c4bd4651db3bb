"""Controller managers (thesis section 3.5), and switching of controllers by clients.

The control mode manager runs the control mode controller, whose table determines the controllers of the joint manager
and the robot manager.
"""

import logging
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import partial
from typing import Any, ClassVar, Self

from valor.common.errors import ConfigurationError
from valor.robot.description import RobotDescription
from valor.robot.kinematic_tree import KinematicTree
from valor.valor_ros_controller.control_modes import ControlModeTable
from valor.valor_ros_controller.controllers.configuration import ControllerConfig
from valor.valor_ros_controller.valor_escher_hw_interface import PELVIS, ValorEscherHWInterface

_log = logging.getLogger("controller_manager")


@dataclass(frozen=True)
class Resources:
    """Parts of the VRC that controllers are made with."""

    hw: ValorEscherHWInterface
    modes: ControlModeTable
    tree: KinematicTree | None = None  # of the robot


class Controller:
    """Controller run by a manager."""

    config: ClassVar[type[ControllerConfig]] = ControllerConfig  # of its entry in controllers.yaml
    name: str  # unique among all controllers
    type: str  # in the form of a ros2_control plug-in
    active = False  # selected by the control mode
    obstacle = ""  # reason that it can never be active

    @classmethod
    def fits(cls, config: Any, robot: RobotDescription) -> bool:
        """Return whether a robot has the controller of an entry of controllers.yaml."""
        groups = config.groups
        return not groups or any(group == PELVIS or robot.tables.group(group) for group in groups)

    @classmethod
    def make(cls, name: str, config: Any, resources: Resources) -> Self:
        """Create the controller of an entry of controllers.yaml."""
        made = cls()
        made.name = name
        return made

    def start(self, hw: ValorEscherHWInterface) -> None:
        self.active = True

    def stop(self, hw: ValorEscherHWInterface, reason: str) -> None:
        """Deactivate; ``reason`` is for clients with active goals."""
        self.active = False

    def update(self, hw: ValorEscherHWInterface) -> None:
        """Run one cycle; also called while inactive, to answer requests."""


class ControllerManager:
    """Controllers by name, those allowed by the control mode, and the active ones."""

    def __init__(self, name: str, controllers: Iterable[Controller]) -> None:
        self.name = name
        self.controllers: dict[str, Controller] = {controller.name: controller for controller in controllers}  # by name
        self._mode = ""
        self._allowed: frozenset[str] = frozenset()
        self.active: tuple[str, ...] = ()  # names of the active controllers, sorted; a new object on each change

    def check(self, names: Sequence[str], where: str) -> None:
        """Check that all names exist. Raises ConfigurationError: one does not; ``where`` names the table."""
        if unknown := [name for name in names if name not in self.controllers]:
            known = ", ".join(self.controllers) or "none"
            raise ConfigurationError(f"{where}: unknown controller {unknown[0]!r}; the {self.name} manager has {known}")

    def enter(
        self,
        mode: str,
        names: Sequence[str],
        hw: ValorEscherHWInterface,
        reason: str,
        *,
        optional: Sequence[str] = (),
        restart: bool = False,
    ) -> None:
        """Activate exactly these controllers on entry to a control mode; with ``restart``, restart active ones.

        ``optional`` controllers stay as they are, active or not.
        """
        if mode == self._mode and not restart:
            return
        self._mode = mode
        self._allowed = frozenset((*names, *optional))
        names = [*names, *(name for name in optional if name in self.active)]
        leaving = [name for name in self.active if restart or name not in self._allowed]
        self.apply(leaving, [name for name in names if restart or name not in self.active], hw, reason)

    def allows(self, name: str) -> bool:
        """Whether a controller may be active in the current mode."""
        return name in self._allowed

    def apply(self, leaving: Sequence[str], coming: Sequence[str], hw: ValorEscherHWInterface, reason: str) -> None:
        """Stop active controllers, then start others, within one cycle."""
        if not (leaving or coming):
            return
        for name in leaving:
            self.controllers[name].stop(hw, reason)
        for name in coming:
            self.controllers[name].start(hw)
        stay = [name for name in self.active if name not in leaving]
        self.active = tuple(sorted((*stay, *coming)))
        _log.info("%s controllers: %s (%s)", self.name, ", ".join(self.active) or "none", reason)

    def update(self, hw: ValorEscherHWInterface) -> None:
        for controller in self.controllers.values():
            controller.update(hw)


class Strictness(IntEnum):
    """Values of ``controller_manager_msgs/srv/SwitchController``."""

    BEST_EFFORT = 1
    STRICT = 2
    AUTO = 3
    FORCE_AUTO = 4


class ControllerSwitch:
    """Switching by clients within the control mode, as ros2_control's ``switch_controller`` (Jazzy). Update thread."""

    def __init__(self, managers: Sequence[ControllerManager], hw: ValorEscherHWInterface) -> None:
        self.managers = tuple(managers)  # all of them; the first has the control modes and is not switched
        self._modes, *self._managers = managers
        self._hw = hw

    def switch(self, activate: Sequence[str], deactivate: Sequence[str], strictness: int) -> tuple[bool, str]:
        """Switch controllers within this cycle; returns success, and the reasons of what was not done.

        Args:
            activate: names.
            deactivate: names; a controller in both lists restarts.
            strictness: STRICT: all or nothing. Others, equivalent without controller chains: all that is possible, a
                failure if nothing of a list is.
        """
        if strictness not in (0, *Strictness):
            return False, f"strictness {strictness}; expected 1 (BEST_EFFORT) or 2 (STRICT)"
        strict, failed = strictness == Strictness.STRICT, False
        leaving, coming, rejections = list[str](), list[str](), list[str]()
        for requested, chosen, check in (
            (deactivate, leaving, self._against_stop),
            (activate, coming, partial(self._against_start, restarting=deactivate)),
        ):
            names = dict.fromkeys(requested)
            reasons = []
            for name in names:
                reason, already = check(name)
                if not reason:
                    chosen.append(name)
                elif strict or not already:
                    reasons.append(reason)
            failed = failed or 0 < len(names) == len(reasons)
            rejections += reasons
        text = "; ".join(rejections)
        if strict and rejections:
            return False, text
        reason = f"switched by a client in {self._hw.situation}"
        for manager in self._managers:
            ours = manager.controllers
            manager.apply([n for n in leaving if n in ours], [n for n in coming if n in ours], self._hw, reason)
        return not failed, text

    def _against_stop(self, name: str) -> tuple[str, bool]:
        """Reason not to stop a controller, empty if there is none; whether it is that it is not active."""
        if name in self._modes.controllers:
            return f"{name} has the control modes and is always active", False
        if (manager := self._manager(name)) is None:
            return self._unknown(name), False
        return ("", False) if name in manager.active else (f"{name} is not active", True)

    def _against_start(self, name: str, restarting: Sequence[str]) -> tuple[str, bool]:
        """Reason not to start a controller, empty if there is none; whether it is that it is active."""
        manager = self._manager(name)
        if name in self._modes.controllers or (manager and name in manager.active):
            return ("", False) if manager and name in restarting else (f"{name} is already active", True)
        if manager is None:
            return self._unknown(name), False
        reason = "" if manager.allows(name) else f"{name} may not be active: {self._hw.situation}"
        return manager.controllers[name].obstacle or reason, False

    def _manager(self, name: str) -> ControllerManager | None:
        return next((manager for manager in self._managers if name in manager.controllers), None)

    def _unknown(self, name: str) -> str:
        known = ", ".join(name for manager in self.managers for name in manager.controllers)
        return f"unknown controller {name!r}; expected one of {known}"
