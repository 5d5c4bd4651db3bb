"""Latest values of the robot's ROS 2 topics, with their ages."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from math import isfinite
from typing import Any

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.balance_controllers import allowed
from valor.common.poses import Pose
from valor.operator_station.robot.modes import Mode
from valor.ros.limbs import FEET

OLD = 0.5  # older values are grey [s]
OLD_BEHIND_LINK = 1.5  # the same with a link, which sends 10 states per second, and upper bounds of ages
REPEATED = {"mode": 1.0, "picture": 0.5}  # additional age of values sent at a low rate [s]


class Ages:
    """Times of reception. ``now`` is monotonic [s]."""

    def __init__(self) -> None:
        self._heard: dict[str, float] = {}
        self._told: frozenset[str] = frozenset()
        self._old = OLD

    def by_others(self, names: Iterable[str]) -> None:
        """Accept ages of these values from the link only."""
        self._told = frozenset(names)
        self._old = OLD_BEHIND_LINK

    def tell(self, name: str, age: float, now: float) -> None:
        """Set the age of a value [s]."""
        self._heard[name] = now - age

    def heard(self, name: str, now: float) -> None:
        """Note a received value."""
        if name not in self._told:
            self._heard[name] = now

    def age(self, name: str, now: float) -> float:
        """Return the age of a value [s]; infinite if none was received."""
        return now - self._heard.get(name, float("-inf"))

    def old(self, name: str, now: float) -> bool:
        """Whether a value is shown in grey."""
        return self.age(name, now) > self._old + REPEATED.get(name, 0.0)

    def text(self, name: str, now: float) -> str:
        """Return the age for display, constant while the value is fresh."""
        if (age := self.age(name, now)) == float("inf"):
            return "never heard"
        return "fresh" if not self.old(name, now) else f"{age:.1f} s old" if age < 10.0 else f"{age:.0f} s old"


AGES = {
    "joints": "state_age", "pelvis": "state_age", **dict.fromkeys(FEET, "state_age"),
    "status": "state_age", "motion": "behavior_age", "mode": "mode_age",
    "picture": "picture_age", "velocity": "velocity_age",
}  # fmt: skip
"""Values of ``/link/status`` with an upper bound of the age of what the page shows."""
COMMANDS = ("last_command", "command_2", "command_3")
_WHEN_LOST = {
    "go_on": "What was approved before a cut goes on to its end.",
    "stop": "A robot that walks is stopped {after} s after its operator was last heard; all else goes on.",
}


@dataclass(frozen=True)
class LinkStatus:
    """Message ``/link/status``: summary and values."""

    said: str
    values: Mapping[str, str]

    def age(self, key: str) -> float | None:
        """Return a value [s], or None if it is unknown."""
        try:
            age = float(self.values[key])
        except (KeyError, ValueError):
            return None
        return age if isfinite(age) else None

    def lines(self) -> list[str]:
        """Describe the link, the reaction to its loss, and the latest commands."""
        fast = "open" if self.values.get("fast_channel") == "true" else "closed"
        age = self.age("state_age")
        old = "" if age is None else f", its state is {age:.1f} s old, the fast channel is {fast}"
        lines = [f"Link: {self.said}{old}."]
        if lost := _WHEN_LOST.get(self.values.get("when_lost", "")):
            lines.append(lost.format(after=self.values.get("lost_after", "?")))
        return [*lines, *(f"→ {self.values[key]}" for key in COMMANDS if self.values.get(key))]


NEWS = 40  # stored texts


@dataclass
class RobotSnapshot:
    """Latest values; poses and points are in odom, ``ages`` are by attribute name."""

    ages: Ages = field(default_factory=Ages)
    joints: dict[str, float] = field(default_factory=dict)  # [rad]
    pelvis: Pose = field(default_factory=Pose)
    fixtures: FloatArray = field(default_factory=lambda: np.zeros(0))  # joints of the simulated world [rad]
    points: dict[str, FloatArray] = field(default_factory=dict)  # com, dcm, … → (3,) [m]
    wrenches: dict[str, FloatArray] = field(default_factory=dict)  # (6,) on the robot, in its frame [N, N·m]
    contacts: list[bool] = field(default_factory=lambda: [True, True])
    states: dict[str, str] = field(default_factory=dict)
    mode: Mode = field(default_factory=Mode)
    controllers: Any = None  # ControllerStatus; None before the first
    steps: list[tuple[int, int, Pose]] = field(default_factory=list)  # index, foot, sole
    hands: dict[str, tuple[str, str, float]] = field(default_factory=dict)  # state, reason, error [m]
    status: tuple[int, str] = (0, "")  # level and text
    news: deque[tuple[float, str]] = field(default_factory=lambda: deque(maxlen=NEWS))
    link: LinkStatus | None = None  # None: no link, or no status received
    picture: bytes = b""  # compressed

    @property
    def behavior(self) -> str:
        """Behavior of the Motion System; empty before the first report."""
        return self.states.get("behavior", "")

    @property
    def allowed(self) -> list[str]:
        """Controllers that may be chosen in the present behavior, the chosen one first."""
        return allowed(self.controllers, self.behavior) if self.controllers else []

    def tell(self, when: float, text: str) -> None:
        """Add news, unless it repeats the latest."""
        if not self.news or self.news[0][1] != text:
            self.news.appendleft((when, text))
