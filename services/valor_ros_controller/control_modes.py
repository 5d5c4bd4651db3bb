"""Control modes (thesis figure 4.3): their table, read from ``control_modes.yaml``, and admission of requests."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol, Self

from msgspec import structs

from valor.common.behaviors import EMERGENCY_STOP, MANIPULATING
from valor.common.messages import ModeStatus
from valor.common.table import Table, TableError, read

FILE = Path(__file__).with_name("control_modes.yaml")


class ControlMode(Table, kw_only=True):
    """Control mode; the file explains the keys."""

    bdi: int
    upper_body: Literal[-1, 0, 1]
    switch: Literal["immediate", "on_feedback", "hard_reset"]
    motion: tuple[str, str] | None
    joint_controllers: tuple[str, ...]
    robot_controllers: tuple[str, ...] = ()
    optional_controllers: tuple[str, ...] = ()
    to: frozenset[str]
    preempts: bool = False
    when_done: str | None = None
    lacking: str = ""  # not in the file: limbs that the robot lacks for this mode


@dataclass(frozen=True)
class Target:
    """Mode that a request leads to; of an emergency stop, alternatives if the Motion System rejects it."""

    mode: str
    other_stops: tuple[str, ...] = ()


class ControlModeTable(Table):
    """The complete file."""

    sets: dict[str, tuple[str, ...]]  # for references within the file
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
    def load(cls, file: Path = FILE) -> Self:
        """Read the table. Raises ConfigurationError: the file or a key is missing or invalid."""
        return read(cls, file)

    def without(self, controllers: Collection[str], lacking: str) -> Self:
        """Table of a robot that lacks the limbs of some joint controllers.

        ``lacking``: reason to reject the modes that manipulate; empty: they are accepted.
        """
        made = {
            name: structs.replace(
                mode,
                joint_controllers=tuple(each for each in mode.joint_controllers if each not in controllers),
                optional_controllers=tuple(each for each in mode.optional_controllers if each not in controllers),
                lacking=lacking if mode.motion and mode.motion[1] in MANIPULATING else "",
            )
            for name, mode in self.modes.items()
        }
        return structs.replace(self, modes=made)

    def fits(self, mode: str, behavior: str) -> bool:
        """Whether ``behavior`` of the Motion System corresponds to ``mode``."""
        motion = self.modes[mode].motion
        return (motion is not None and motion[1] == behavior) or self.behaviors.get(behavior) == mode

    def running(self, controller: str) -> list[str]:
        return [name for name, mode in self.modes.items() if controller in mode.joint_controllers]

    def first_stop(self, current: str, stops: Sequence[str]) -> Target | None:
        """First of ``stops`` that may follow ``current``; None if there is none."""
        allowed = self.modes[current].to
        mode = next((stop for stop in stops if stop == current or stop in allowed), None)
        return None if mode is None else Target(mode, tuple(stop for stop in stops if stop != mode))

    def followers(self, current: str, behavior: str) -> frozenset[str]:
        """Modes that may follow; of a mode without behaviors, only those that may follow ``behavior`` too."""
        follows = self.modes[current].to
        if self.modes[current].motion is None:
            kept = self.behaviors.get(behavior, current)
            follows &= self.modes[kept].to | {kept}
        return follows


@dataclass(frozen=True)
class ModeReport:
    """Content of ``ControlModeStatus``."""

    requested: str
    current: str
    status: ModeStatus


class ModeClient(Protocol):
    """Client that requested a mode and waits for the result."""

    def processing(self, report: ModeReport) -> None:
        """Report that the change has started."""

    def finish(self, report: ModeReport) -> None:
        """Report the result of the change."""


class ModeRejectedError(ValueError):
    """Rejected request: the reason, and ``error`` for ``ControlModeStatus``."""

    def __init__(self, error: ModeStatus, text: str) -> None:
        super().__init__(text)
        self.error = error


def admit(table: ControlModeTable, requested: str, current: str, behavior: str, under_way: str) -> Target:
    """Mode that a request leads to, by name in any case or as the emergency stop.

    ``behavior``: of the Motion System; ``under_way``: target of a change in progress, empty if there is none.
    Raises ModeRejectedError: the request is rejected.
    """
    modes, target = table.modes, Target(requested.strip().lower())
    if target.mode == EMERGENCY_STOP:
        stop = table.first_stop(current, table.emergency_stop)
        if stop is None:
            allowed = ", ".join(sorted(modes[current].to))
            reason = f"no stop mode may follow {current}; the joints are not controlled; allowed from there: {allowed}"
            raise ModeRejectedError(ModeStatus.ERR_INVALID_TRANSITION, reason)
        target = stop
    name = target.mode
    if name not in modes:
        reason = f"unknown mode; expected one of {', '.join(modes)}"
        raise ModeRejectedError(ModeStatus.ERR_INVALID_BEHAVIOR_MODE, reason)
    if modes[name].lacking:
        raise ModeRejectedError(ModeStatus.ERR_INVALID_BEHAVIOR_MODE, modes[name].lacking)
    if under_way and not (modes[name].preempts and under_way != name):
        stops = ", ".join(sorted(each for each, mode in modes.items() if mode.preempts and each != under_way))
        reason = f"the change to {under_way} is in progress; request it again afterwards; allowed now: {stops}"
        raise ModeRejectedError(ModeStatus.ERR_PRIOR_COMMAND_IN_PROGRESS, reason)
    follows = table.followers(current, behavior)
    # The progress of a change is unknown: its target's followers are admitted too.
    if name not in follows | (modes[under_way].to if under_way else frozenset()) | {current}:
        kept = "" if modes[current].motion else f" in behavior {behavior}"
        reason = f"not allowed from {current}{kept}; from there: {', '.join(sorted(follows))}"
        raise ModeRejectedError(ModeStatus.ERR_INVALID_TRANSITION, reason)
    return target
