"""Selection of topics by patterns of their names."""

from dataclasses import dataclass
from fnmatch import fnmatchcase

BULKY = "*/multisense/*"  # up to 200 MB/s
SMALL = ("/compressed", "/camera_info")  # ends of others of these


@dataclass(frozen=True)
class Selection:
    """Shell patterns such as ``/bifrost/*/statistics``; ``*`` matches slashes."""

    only: tuple[str, ...] = ()  # patterns of selected topics; empty selects all but images, depth and clouds of cameras
    without: tuple[str, ...] = ()  # patterns of topics excluded from these

    def __contains__(self, topic: str) -> bool:
        if not self.only and fnmatchcase(topic, BULKY) and not topic.endswith(SMALL):
            return False
        if self.only and not any(fnmatchcase(topic, pattern) for pattern in self.only):
            return False
        return not any(fnmatchcase(topic, pattern) for pattern in self.without)


EVERYTHING = Selection()
