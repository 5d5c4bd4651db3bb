"""Which control modes may be asked for, from where (thesis figure 4.3), and what who asks is told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from valor.common.behaviors import EMERGENCY_STOP
from valor.common.messages import ModeStatus
from valor.valor_ros_controller.control_modes import ControlModeTable


@dataclass(frozen=True)
class ModeReport:
    """The content of ``ControlModeStatus``."""

    requested: str
    current: str
    status: ModeStatus


class ModeClient(Protocol):
    """Somebody who asked for a mode and waits for what became of it."""

    def processing(self, report: ModeReport) -> None:
        """The change is under way."""

    def finish(self, report: ModeReport) -> None:
        """The change is over, one way or the other."""


class ModeRefusedError(ValueError):
    """A request that is not followed: its text says why, ``error`` as ``ControlModeStatus`` has it."""

    def __init__(self, error: ModeStatus, text: str) -> None:
        super().__init__(text)
        self.error = error


@dataclass(frozen=True)
class Target:
    """The mode that a request leads to; of an emergency, what else to ask for if the Motion System refuses it."""

    mode: str
    other_stops: tuple[str, ...] = ()


def first_stop(table: ControlModeTable, current: str, stops: Sequence[str]) -> Target | None:
    """The first of these modes that a mode may be stopped in; None: there is none."""
    may = table.modes[current].to
    mode = next((stop for stop in stops if stop == current or stop in may), None)
    return None if mode is None else Target(mode, tuple(stop for stop in stops if stop != mode))


def admit(table: ControlModeTable, requested: str, current: str, behavior: str, under_way: str) -> Target:
    """Where a request leads.

    Args:
        table: of control modes.
        requested: a mode by name, in any case, or an emergency stop.
        current: the mode that the robot is in.
        behavior: of the Motion System.
        under_way: the mode that a change under way leads to; empty: none is.

    Raises:
        ModeRefusedError: nowhere.
    """
    modes, target = table.modes, Target(requested.strip().lower())
    if target.mode == EMERGENCY_STOP:
        stop = first_stop(table, current, table.emergency_stop)
        if stop is None:
            allowed = ", ".join(sorted(modes[current].to))
            reason = f"no mode to stop in may follow {current}; the joints are not under control; from there: {allowed}"
            raise ModeRefusedError(ModeStatus.ERR_INVALID_TRANSITION, reason)
        target = stop
    name = target.mode
    if name not in modes:
        reason = f"no such mode; expected one of {', '.join(modes)}"
        raise ModeRefusedError(ModeStatus.ERR_INVALID_BEHAVIOR_MODE, reason)
    if modes[name].lacking:
        raise ModeRefusedError(ModeStatus.ERR_INVALID_BEHAVIOR_MODE, modes[name].lacking)
    if under_way and not (modes[name].preempts and under_way != name):
        stops = ", ".join(sorted(each for each, mode in modes.items() if mode.preempts and each != under_way))
        reason = f"the change to {under_way} is under way; ask again once it is done; meanwhile: {stops}"
        raise ModeRefusedError(ModeStatus.ERR_PRIOR_COMMAND_IN_PROGRESS, reason)
    follows = _may_follow(table, current, behavior)
    # Of a change under way nobody knows how far it is.
    if name not in follows | (modes[under_way].to if under_way else frozenset()) | {current}:
        kept = "" if modes[current].motion else f" in behavior {behavior}"
        reason = f"not allowed from {current}{kept}; from there: {', '.join(sorted(follows))}"
        raise ModeRefusedError(ModeStatus.ERR_INVALID_TRANSITION, reason)
    return target


def _may_follow(table: ControlModeTable, current: str, behavior: str) -> frozenset[str]:
    """The modes that may follow; where the present one keeps whatever behavior there is, those that may follow that."""
    follows = table.modes[current].to
    if table.modes[current].motion is None:
        kept = table.behaviors.get(behavior, current)
        follows &= table.modes[kept].to | {kept}
    return follows
