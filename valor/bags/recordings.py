"""Recordings in an instance's folder of bags: listing, state, and the bag that holds a moment.

A recording is a folder that the recorder named by its start time, with its pieces (``<name>/<name>.mcap``,
``<name>_1.mcap`` …) and rosbag2's ``metadata.yaml``. Other content is ignored: links, other names, files of other
programs. Listing uses names, sizes and times; no bag is read beyond its first bytes.
"""

import contextlib
import fcntl
import os
import re
import stat
import time
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import BinaryIO, Literal, NamedTuple

import msgspec

from valor.bags.files import BEGINNING, SUFFIX, is_own_folder, origin
from valor.common.table import Table, checked

KEEP = "KEEP"  # marker file in the folder of a recording that is kept
_TIME = "%Y-%m-%d_%H-%M-%S"
_NAME = re.compile(r"(\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d)(?:_[a-z]+)?(?:_\d+)?")


class Unfinished(Table):
    """The recorder's note of bags that it started and did not finish."""

    unfinished: tuple[Path, ...] = ()


class Piece(NamedTuple):
    """One file of a recording."""

    path: Path
    size: int  # [B]
    ended: float  # last modification, wall clock [s]


@dataclass(frozen=True)
class Recording:
    """One folder: the output of a recorder from its start to its end."""

    folder: Path
    files: tuple[Piece, ...]  # in the order of writing
    begun: float  # start according to the name, wall clock [s]
    kept: bool  # marked to be kept

    @property
    def name(self) -> str:
        return self.folder.name

    @property
    def size(self) -> int:
        return sum(piece.size for piece in self.files)

    @property
    def ended(self) -> float:
        """Last modification, wall clock [s]."""
        return self.files[-1].ended

    @property
    def written(self) -> bool:
        return any(state(piece.path) == "written" for piece in self.files)


def name_of(moment: datetime) -> str:
    """The name of a recording that starts at a moment."""
    return f"{moment:{_TIME}}"


def begun(name: str) -> float:
    """Start of a recording, wall clock [s]; raises ``ValueError`` if the name is not a recorder's."""
    named = _NAME.fullmatch(name)
    if not named:
        raise ValueError(f"{name}: expected a time")
    return datetime.strptime(named[1], _TIME).timestamp()


def look(bags: Path) -> list[Recording]:
    """All recordings of a folder, the oldest first."""
    found = []
    with contextlib.suppress(OSError), os.scandir(bags) as entries:
        for entry in entries:
            with contextlib.suppress(ValueError):  # a name that is no time
                start, folder = begun(entry.name), Path(entry.path)
                if entry.is_dir(follow_symlinks=False) and (files := _pieces(folder)):
                    found.append(Recording(folder, files, start, os.path.lexists(folder / KEEP)))
    return sorted(found, key=lambda each: (each.ended, each.name))


def _pieces(folder: Path) -> tuple[Piece, ...]:
    files = []
    for path in pieces_of(folder / f"{folder.name}{SUFFIX}"):
        with contextlib.suppress(OSError):  # removed since it was listed
            found = path.lstat()
            if stat.S_ISREG(found.st_mode):
                files.append(Piece(path, found.st_size, found.st_mtime))
    return tuple(sorted(files, key=lambda each: (each.ended, each.path)))


def pieces_of(bag: Path) -> list[Path]:
    """A bag and, if its folder has its name, the bags that it was split into."""
    if not is_own_folder(bag):
        return [bag]
    return [piece for piece in bag.parent.glob(f"*{SUFFIX}") if is_own_folder(piece)]


def state(bag: Path) -> Literal["written", "closed", "foreign"]:
    """The state of a bag. A recorder locks the file that it writes before it writes the first byte."""
    try:
        with opened(bag) as file:
            if file.read(len(BEGINNING)) != BEGINNING:
                return "foreign"
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return "written"
    except OSError:  # removed, a link, or not readable
        return "foreign"
    return "closed"


def opened(bag: Path) -> BinaryIO:
    """Open a bag for reading without following links."""
    return open(os.open(bag, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC), "rb")


def notes_file(folder: Path) -> Path:
    """The recorder's note of unfinished bags, in its instance's folder."""
    return folder / "bag_recorder.json"


def unfinished(folder: Path) -> list[Path]:
    """The unfinished bags of an instance's recorder: the current one, and those left by a crash."""
    try:
        return list(checked(Unfinished, msgspec.json.decode(notes_file(folder).read_bytes())).unfinished)
    except (OSError, ValueError):
        return []


def being_written(folder: Path) -> Path | None:
    """The bag that the recorder of an instance's folder writes now."""
    return next((bag for bag in reversed(unfinished(folder)) if state(bag) == "written"), None)


def start_of(bag: Path) -> float:
    """Start of a bag, finished or not, wall clock [s]; its last modification if the bag does not state its start."""
    with contextlib.suppress(OSError, ValueError, KeyError):
        return datetime.fromisoformat(origin(bag)["started"]).timestamp()
    with contextlib.suppress(OSError):
        return bag.stat().st_mtime
    return time.time()


def holding(instance_folder: Path, when: float) -> Path | None:
    """The bag of an instance that holds a moment, wall clock [s]; None if no bag does."""
    written = being_written(instance_folder)
    if written is not None and start_of(written) <= when:
        return written
    for recording in reversed(look(instance_folder / "bags")):
        from valor.bags import rosbag2_metadata  # imports YAML and MCAP, which most `status` calls do not need

        head = rosbag2_metadata.head(recording.folder)
        start = head.start if head else recording.begun
        for piece in recording.files:
            if start <= when <= piece.ended:
                return piece.path
            start = piece.ended
    return None


def keep(recording: Recording, marked: bool) -> None:
    """Mark a recording to be kept, or remove the mark; raises ``OSError`` if the folder cannot be written."""
    if marked:
        (recording.folder / KEEP).touch()
    else:
        (recording.folder / KEEP).unlink(missing_ok=True)
