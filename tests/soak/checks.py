"""Checks of all that a soak receives and finds; the unit tests try each with a fault."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from valor.common.behaviors import BEHAVIOR_TRANSITIONS, OPERATIONAL, REFLEX, Behavior
from valor.common.messages import Motor
from valor.motion_manager.safety import RESUMED
from valor.robot.description import RobotDescription
from valor.valor_ros_controller.control_modes import ControlModeTable

ROUNDING = 1e-9  # of a limit [rad, N·m]
WARM_UP = 60.0  # of a process, in which it may still grow [s]
SPAN = 60.0  # least time of samples after it [s]
GROWTH = 8.0  # most growth of a process' memory [MiB]
GROWTH_OF = {"bag_recorder": 24.0}  # likewise, of a process that keeps the memory of its queues
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


def growth(samples: Sequence[tuple[float, float]]) -> float:
    """Growth of a process' memory after its warm-up [MiB], from samples of time [s] and memory [MiB].

    The difference of the medians of the last and the first quarter; 0 if the samples span too little time.
    """
    warm = [each for each in samples if each[0] - samples[0][0] >= WARM_UP]
    if len(warm) < 8 or warm[-1][0] - warm[0][0] < SPAN:
        return 0.0
    quarter = len(warm) // 4
    memory = [each[1] for each in warm]
    return float(np.median(memory[-quarter:]) - np.median(memory[:quarter]))


def in_logs(folder: Path) -> list[str]:
    """Tracebacks and aborts that services' logs report."""
    found = []
    for file in sorted(folder.glob("*.log*")):
        text = file.read_text(errors="replace")
        found += [f"{file.name}: {word}" for word in _GRAVE.findall(text)]
    return found


def unexpected_ends(restarts: Mapping[str, int], killed: Mapping[str, int]) -> list[str]:
    """Processes that ended more often than they were killed."""
    return [
        f"{name} ended {count - killed.get(name, 0)} times by itself"
        for name, count in restarts.items()
        if count > killed.get(name, 0)
    ]


MODES = ControlModeTable.load()
STEPPING = frozenset({Behavior.STEP, Behavior.STEP_MANIPULATE, Behavior.WALK, Behavior.WALK_MANIPULATE})
"""A foot may be in the air."""
BY_ITSELF: Mapping[Behavior, frozenset[Behavior]] = {
    Behavior.IDLE: frozenset({Behavior.STAND_PREP}),
    Behavior.STEP: frozenset({Behavior.STAND}),
    Behavior.STEP_MANIPULATE: frozenset({Behavior.STAND, Behavior.STAND_MANIPULATE}),
    Behavior.GET_UP: frozenset({Behavior.STAND_PREP, Behavior.FALL}),
}
"""Where the robot goes without being asked: the end of a plan, of the way up."""
_WORLDS = ("comms_manager", "device_emulators")
UNITS_NEEDED: Mapping[str, Behavior] = {
    "legs/1": Behavior.FREEZE, "imu": Behavior.FREEZE, "force_torque/1": Behavior.SOFT_STOP,
}  # fmt: skip
"""Units without which no balance is kept → where the robot goes when they are unplugged; all others: nowhere."""
_BALANCING = OPERATIONAL | {Behavior.SOFT_STOP}
_PASSED = _BALANCING
"""Passed through within one period: by two requests, or Soft Stop, in which a robot that steps is held after a gap."""


def lawful(before: Behavior, after: Behavior, *, anew: bool) -> bool:
    """Return whether a Motor's behavior may follow another's; ``anew``: another Motion Manager made it."""
    if anew:
        return after in {RESUMED[before], Behavior.FALL}
    beyond = {each for next_ in BEHAVIOR_TRANSITIONS[before].keys() & _PASSED for each in BEHAVIOR_TRANSITIONS[next_]}
    return after is before or after in BEHAVIOR_TRANSITIONS[before].keys() | beyond


def outcomes(event: str, process: str, behavior: Behavior) -> frozenset[Behavior]:
    """Behaviors that the robot may be in after an event: a process is killed or stopped, or a unit is unplugged."""
    stay = frozenset({behavior}) | BY_ITSELF.get(behavior, frozenset())
    fall = frozenset({Behavior.FALL})
    if event == "unplug":
        needed = behavior in _BALANCING and process in UNITS_NEEDED
        return stay | ({UNITS_NEEDED[process]} | (fall if behavior in STEPPING else set()) if needed else frozenset())
    if (event, process) == ("kill", "motion_manager"):
        return frozenset({RESUMED[behavior]}) | (fall if behavior in STEPPING else frozenset())
    if event == "kill" and process in _WORLDS:  # another world, or a gap
        return (fall | {Behavior.FREEZE} if behavior in _BALANCING else frozenset({RESUMED[behavior]})) | stay
    if event == "stop" and process in ("motion_manager", *_WORLDS):
        held = frozenset({Behavior.FREEZE} if behavior in _BALANCING | {Behavior.STAND_PREP} else ())
        return stay | held | (fall if behavior in STEPPING else frozenset())
    return stay


def way(start: Behavior, goal: Behavior) -> list[Behavior]:
    """The shortest sequence of requests from a behavior to another."""
    closed = {Behavior.GET_UP, Behavior.FALL, Behavior.SOFT_STOP} - {goal}
    ways = deque([[start]])
    seen = {start}
    while ways:
        here = ways.popleft()
        if here[-1] is goal:
            return here[1:]
        for after in BEHAVIOR_TRANSITIONS[here[-1]]:
            if after not in seen and after not in closed:
                seen.add(after)
                ways.append([*here, after])
    raise LookupError(f"no way from {start} to {goal}")


def fit(mode: str, behavior: str) -> bool:
    """Return whether the VRC may report a mode while the Motion Manager is in a behavior, both being at rest."""
    row = MODES.modes.get(mode)
    return (
        mode == "stop" or MODES.behaviors[behavior] == mode or bool(row and row.motion and row.motion[-1] == behavior)
    )
