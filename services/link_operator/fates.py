"""What became of each command that the operator sent."""

from __future__ import annotations

import time
from collections import OrderedDict
from dataclasses import dataclass, field

KEPT = 8  # commands that are told of
OPEN = ("on its way", "begun")


@dataclass
class _Fate:
    name: str
    state: str
    since: float = field(default_factory=time.monotonic)  # [s]


class Fates:
    """The newest commands; of each its name, number and what is known of it."""

    def __init__(self) -> None:
        self._fates: OrderedDict[int, _Fate] = OrderedDict()
        self._unsent = 0

    def sent(self, number: int, name: str) -> None:
        """A command has the link's id."""
        self._put(number, name, OPEN[0])

    def unsent(self, name: str, why: str) -> None:
        """A command has not got so far."""
        self._unsent -= 1
        self._put(self._unsent, name, f"not sent: {why}")

    def became(self, number: int, state: str) -> None:
        """More is known of one."""
        if (fate := self._fates.get(number)) is not None:
            fate.state, fate.since = state, time.monotonic()

    def lose_all(self, why: str) -> None:
        """Nothing more will be heard of those that are open."""
        known, self._fates = list(self._fates.values()), OrderedDict()
        for fate in known:
            if fate.state in OPEN:
                fate.state = why
            self._unsent -= 1
            self._fates[self._unsent] = fate  # the link's ids begin anew

    def name(self, number: int) -> str:
        """Of a command; empty: not known."""
        fate = self._fates.get(number)
        return fate.name if fate is not None else ""

    def lines(self, now: float) -> dict[str, str]:
        """For ``/link/status``: ``last_command``, and before it ``command_2``, …, the newest first."""
        keys = ("last_command", *(f"command_{place}" for place in range(2, KEPT + 1)))
        told = [
            f"{fate.name.removesuffix('/follow_joint_trajectory').rsplit('/', 1)[-1]}: {fate.state}, "
            f"{now - fate.since:.0f} s ago"
            for fate in reversed(self._fates.values())
        ]
        return dict(zip(keys, told or [""], strict=False))

    def _put(self, number: int, name: str, state: str) -> None:
        self._fates[number] = _Fate(name, state)
        while len(self._fates) > KEPT:
            self._fates.popitem(last=False)
