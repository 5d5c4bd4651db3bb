"""What must hold of all that a soak hears and finds; each check is tried with a fault of its own in the unit tests."""

from __future__ import annotations

import re
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from tests.soak.rules import lawful
from valor.bags.errors import BagError
from valor.bags.recovery import recover
from valor.common.behaviors import REFLEX, Behavior
from valor.common.messages import MotionState, Motor
from valor.robot.description import RobotDescription

ROUNDING = 1e-9  # of a limit [rad, N·m]
KEPT = 1000  # Motors whose behavior is remembered until their MotionState comes
WARM_UP = 60.0  # of a process, in which it may still grow [s]
SPAN = 60.0  # of samples that say something [s]
GROWTH = 8.0  # between the first and the last quarter of the samples [MiB]
HELD_UP = {"bag_recorder": 24.0}  # likewise, of who keeps what its queues of seconds once took
_GRAVE = re.compile(r"Traceback \(most recent|Assertion failed|SIGABRT|SIGSEGV")
_VECTORS = ("position", "velocity", "effort", "stiffness", "damping")


class MotorChecks:
    """Each Motor by itself, and after the one before it."""

    def __init__(self, robot: RobotDescription) -> None:
        self._robot = robot
        self._before: Motor | None = None
        self._led = ""  # behavior of the newest Motor of one that leads
        self._anew = False  # since then another Motion Manager began, or stood aside

    def find(self, motor: Motor) -> list[str]:
        """What is wrong with it."""
        found = [*self._numbers(motor), *self._order(motor), *self._behavior(motor)]
        self._before = motor
        return found

    def _numbers(self, motor: Motor) -> list[str]:
        robot = self._robot
        for name in _VECTORS:
            if not np.isfinite(getattr(motor, name)).all():
                return [f"Motor: {name} not finite"]
        beyond = (motor.position < robot.lower - ROUNDING) | (motor.position > robot.upper + ROUNDING)
        strong = np.abs(motor.effort) > robot.effort_limit + ROUNDING
        found = []
        if beyond.any():
            found.append(f"Motor: position of {robot.joints[int(beyond.argmax())]} beyond its limits")
        if strong.any():
            found.append(f"Motor: effort of {robot.joints[int(strong.argmax())]} beyond its limit")
        return found

    def _order(self, motor: Motor) -> list[str]:
        before = self._before
        if before is None:
            return []
        found = []
        if motor.writer < before.writer:
            found.append("Motor: of a Motion Manager that another one has followed")
        if motor.writer == before.writer and motor.sequence <= before.sequence:
            found.append("Motor: sequence goes back")
        return found

    def _behavior(self, motor: Motor) -> list[str]:
        before, led = self._before, self._led
        self._anew |= before is not None and motor.writer != before.writer
        if motor.behavior == REFLEX:  # it stands aside
            self._anew = True
            return []
        anew, self._anew, self._led = self._anew, False, motor.behavior
        if motor.behavior not in set(Behavior):
            self._led = led
            return [f"Motor: unknown behavior {motor.behavior!r}"]
        if not led or lawful(Behavior(led), Behavior(motor.behavior), anew=anew):
            return []
        how = "after a restart or the reflex" if anew else "which no edge leads to"
        return [f"behavior {motor.behavior} after {led}, {how}"]


class StateChecks:
    """What the Motion Manager reports against what it commands."""

    def __init__(self) -> None:
        self._commanded: OrderedDict[int, str] = OrderedDict()

    def motor(self, motor: Motor) -> None:
        """One that was heard."""
        self._commanded[motor.proprioceptor_sequence] = motor.behavior
        while len(self._commanded) > KEPT:
            self._commanded.popitem(last=False)

    def find(self, state: MotionState) -> list[str]:
        """What is wrong with a report."""
        commanded = self._commanded.get(state.proprioceptor_sequence, state.behavior)
        if commanded in (state.behavior, REFLEX):
            return []
        return [f"MotionState says {state.behavior}, its Motor {commanded}"]


def growth(samples: Sequence[tuple[float, float]]) -> float:
    """How much more memory a process has at last than at first, its warm-up left out [MiB].

    Args:
        samples: time [s] and memory [MiB] of one process, in order.

    Returns:
        Difference of the medians of the last and the first quarter; 0 of samples over too short a time.
    """
    warm = [each for each in samples if each[0] - samples[0][0] >= WARM_UP]
    if len(warm) < 8 or warm[-1][0] - warm[0][0] < SPAN:
        return 0.0
    quarter = len(warm) // 4
    memory = [each[1] for each in warm]
    return float(np.median(memory[-quarter:]) - np.median(memory[:quarter]))


def order_kept(granted: Sequence[str], seen: Sequence[str]) -> bool:
    """Whether what was granted came about in its order, the last of it for good.

    Two requests between two control periods are both obeyed, and only the second is seen.

    Args:
        granted: behaviors, each other than the one before.
        seen: behaviors entered on request, in order.
    """
    rest = iter(granted)
    return all(each in rest for each in seen) and list(seen[-1:]) == list(granted[-1:])


def in_logs(folder: Path) -> list[str]:
    """Tracebacks and aborts that services' logs tell of."""
    found = []
    for file in sorted(folder.glob("*.log*")):
        text = file.read_text(errors="replace")
        found += [f"{file.name}: {word}" for word in _GRAVE.findall(text)]
    return found


def unreadable(bags: Path) -> list[str]:
    """Bags of a system that is down which nobody has finished, or that cannot be read."""
    found = []
    for bag in sorted(bags.rglob("*.mcap")):
        try:
            if not recover(bag).finished:
                found.append(f"{bag.name} was left unfinished")
        except BagError as error:
            found.append(str(error))
    return found


def unexpected_ends(restarts: Mapping[str, int], killed: Mapping[str, int]) -> list[str]:
    """Processes that ended more often than they were killed."""
    return [
        f"{name} ended {count - killed.get(name, 0)} times by itself"
        for name, count in restarts.items()
        if count > killed.get(name, 0)
    ]
