"""What the robot may do, by the product's own tables: the reference that a soak holds what it sees against."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from pathlib import Path

import yaml

import valor.valor_ros_controller
from valor.common.behaviors import OPERATIONAL, Behavior
from valor.motion_manager.states.transitions import BEHAVIOR_TRANSITIONS, RESUMED

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
    "legs/1": Behavior.FREEZE,
    "imu": Behavior.FREEZE,
    "force_torque/1": Behavior.SOFT_STOP,
}
"""Units without which no balance is kept → where the robot goes when they are unplugged; all others: nowhere."""
_BALANCING = OPERATIONAL | {Behavior.SOFT_STOP}
_PASSED = _BALANCING
"""Passed through within one period: by two requests, or Soft Stop, in which a robot that steps is held after a gap."""


def lawful(before: Behavior, after: Behavior, *, anew: bool) -> bool:
    """Whether a Motor's behavior may follow another's.

    Args:
        before: of the Motor before.
        after: of this one.
        anew: another Motion Manager made this one.
    """
    if anew:
        return after in {RESUMED[before], Behavior.FALL}
    beyond = {each for next_ in BEHAVIOR_TRANSITIONS[before].keys() & _PASSED for each in BEHAVIOR_TRANSITIONS[next_]}
    return after is before or after in BEHAVIOR_TRANSITIONS[before].keys() | beyond


def outcomes(event: str, process: str, behavior: Behavior) -> frozenset[Behavior]:
    """Where the robot may be found after an event.

    Args:
        event: kill; stop; cap (of memory), which may end as either; cut (of links), which is as a short stop; up:
            killed while coming up; unplug, of a unit; or any other, from which nothing follows.
        process: that it happens to; empty: to none.
        behavior: that it happens in.
    """
    stay = frozenset({behavior}) | BY_ITSELF.get(behavior, frozenset())
    fall = frozenset({Behavior.FALL})
    if event == "cap":
        return outcomes("kill", process, behavior) | outcomes("stop", process, behavior)
    if event == "cut":
        return outcomes("stop", process, behavior)
    if event == "up":  # brought to Stand afterwards, or begun anew when it was there
        return frozenset({Behavior.STAND, Behavior.FREEZE}) | (fall if process in _WORLDS else frozenset())
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
    """The shortest way by requests, without the start.

    Raises:
        LookupError: there is none.
    """
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


class Modes:
    """The VRC's table of control modes."""

    def __init__(self) -> None:
        file = Path(valor.valor_ros_controller.__file__).with_name("control_modes.yaml")
        table = yaml.safe_load(file.read_text())
        self.names: list[str] = list(table["modes"])
        self._motion = {name: row["motion"] for name, row in table["modes"].items()}
        self._found: dict[str, str] = table["behaviors"]

    def fit(self, mode: str, behavior: str) -> bool:
        """Whether the VRC may report a mode while the Motion Manager is in a behavior, both being at rest."""
        motion = self._motion.get(mode)
        return mode == "stop" or self._found[behavior] == mode or bool(motion and motion[-1] == behavior)
