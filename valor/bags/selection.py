"""Selection of topics by patterns of their names."""

from dataclasses import dataclass
from fnmatch import fnmatchcase


@dataclass(frozen=True)
class Selection:
    """Shell patterns such as ``/bifrost/*/statistics``; ``*`` matches slashes."""

    only: tuple[str, ...] = ()  # patterns of selected topics; empty selects all
    without: tuple[str, ...] = ()  # patterns of topics excluded from these

    def __contains__(self, topic: str) -> bool:
        if self.only and not any(fnmatchcase(topic, pattern) for pattern in self.only):
            return False
        return not any(fnmatchcase(topic, pattern) for pattern in self.without)


EVERYTHING = Selection()
