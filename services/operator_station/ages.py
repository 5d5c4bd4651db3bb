"""How old every value is that is shown, and when it counts as old."""

from __future__ import annotations

from collections.abc import Iterable

OLD = 0.5  # older values are grey [s]
OLD_BEHIND_LINK = 1.5  # likewise, where states come ten times a second, some late or never, and ages are upper bounds
REPEATED = {"mode": 1.0, "picture": 0.5}  # what is told so seldom may be older by that [s]


class Ages:
    """When each value was heard last. ``now`` [s]: monotonic, or of a recording."""

    def __init__(self) -> None:
        self._heard: dict[str, float] = {}
        self._told: frozenset[str] = frozenset()
        self._old = OLD

    def by_others(self, names: Iterable[str]) -> None:
        """From here on the link says by ``tell`` how old these are, not that they were heard here."""
        self._told = frozenset(names)
        self._old = OLD_BEHIND_LINK

    def tell(self, name: str, age: float, now: float) -> None:
        """Somebody knows how old a value is [s]."""
        self._heard[name] = now - age

    def heard(self, name: str, now: float) -> None:
        """A value is new."""
        if name in self._told:
            return
        self._heard[name] = now

    def age(self, name: str, now: float) -> float:
        """Of a value [s]; infinite if it was never heard."""
        return now - self._heard.get(name, float("-inf"))

    def old(self, name: str, now: float) -> bool:
        """Whether it is to be grey."""
        return self.age(name, now) > self._bound(name)

    def _bound(self, name: str) -> float:
        return self._old + REPEATED.get(name, 0.0)

    def text(self, name: str, now: float) -> str:
        """For people; in steps that they care for, so that what is fresh is not told anew at each look."""
        age = self.age(name, now)
        if age == float("inf"):
            return "never heard"
        return "fresh" if age <= self._bound(name) else f"{age:.1f} s old" if age < 10.0 else f"{age:.0f} s old"
