"""Which topics of a bag: patterns of their names."""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase


@dataclass(frozen=True)
class Selection:
    """Shell patterns (``/bifrost/*/statistics``); a ``*`` matches slashes, too.

    Attributes:
        only: what is chosen; all topics if there is none.
        without: what is left out of that.
    """

    only: tuple[str, ...] = ()
    without: tuple[str, ...] = ()

    def __contains__(self, topic: str) -> bool:
        if self.only and not any(fnmatchcase(topic, pattern) for pattern in self.only):
            return False
        return not any(fnmatchcase(topic, pattern) for pattern in self.without)


EVERYTHING = Selection()
