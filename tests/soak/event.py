"""What a line of the table of events is."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass

from tests.soak.rig import Rig

Happen = Callable[[Rig, random.Random, str], list[str]]


@dataclass(frozen=True)
class Event:
    """One line of the table.

    Attributes:
        happen: given the rig, chance and the process it happens to; returns what was not as it must be.
        weight: how often it comes, relative to the others.
        kind: as ``rules.outcomes`` knows it.
        process: it happens to; empty: to none.
        other: likewise, where it happens to two.
        commands: the robot may go elsewhere in it, for it is told to.
        on_feet: only where a robot stands on both of them.
        idle: only where it does nothing besides, for the system goes down in it.
    """

    happen: Happen
    weight: float
    kind: str = ""
    process: str = ""
    other: str = ""
    commands: bool = False
    on_feet: bool = False
    idle: bool = False

    def possible(self, activity: str) -> bool:
        """Whether it may come while the robot does that."""
        if self.idle:
            return activity == "standing"
        return not self.on_feet or activity in ("standing", "reaching")

    @property
    def hit(self) -> tuple[str, ...]:
        """Those it happens to."""
        return tuple(name for name in (self.process, self.other) if name)
