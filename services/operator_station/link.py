"""What the link says of itself to an operator who has the robot behind it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite

from valor.ros.limbs import FEET

AGES = {
    "joints": "state_age", "pelvis": "state_age", **dict.fromkeys(FEET, "state_age"),
    "status": "state_age", "motion": "behavior_age", "mode": "mode_age",
    "picture": "picture_age", "velocity": "velocity_age",
}  # fmt: skip
"""Of what the page shows, by whose value in ``/link/status`` it is known how old it is: an upper bound."""
COMMANDS = ("last_command", "command_2", "command_3")
_WHEN_LOST = {
    "go_on": "What was approved before a cut goes on to its end.",
    "stop": "A robot that walks is stopped {after} s after its operator was last heard; all else goes on.",
}


@dataclass(frozen=True)
class Link:
    """A look at it.

    Attributes:
        said: in a few words.
        values: of ``/link/status``.
    """

    said: str
    values: Mapping[str, str]

    @classmethod
    def of(cls, said: str, values: Mapping[str, str]) -> Link:
        """What a message says."""
        return cls(said, values)

    def age(self, key: str) -> float | None:
        """A value [s]; None: it is not told, or not known."""
        try:
            age = float(self.values[key])
        except (KeyError, ValueError):
            return None
        return age if isfinite(age) else None

    def lines(self) -> list[str]:
        """For people: how the link is, what the robot does without its operator, what became of commands."""
        fast = "open" if self.values.get("fast_channel") == "true" else "closed"
        age = self.age("state_age")
        old = "" if age is None else f", its state is {age:.1f} s old, the fast channel is {fast}"
        lines = [f"Link: {self.said}{old}."]
        if lost := _WHEN_LOST.get(self.values.get("when_lost", "")):
            lines.append(lost.format(after=self.values.get("lost_after", "?")))
        return [*lines, *(f"→ {self.values[key]}" for key in COMMANDS if self.values.get(key))]
