"""The recordings in an instance's folder of bags: what there is, which may go, and how one goes.

A recording is a folder that the recorder named by the time, with its pieces (``<name>/<name>.mcap``, ``<name>_1.mcap``
…) and rosbag2's ``metadata.yaml``. Whatever else is there is somebody else's: links, other names, files that the
recorder did not write. Everything here looks at names, sizes and times; no bag is read beyond its first bytes.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import shutil
import stat
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import BinaryIO, Literal

import msgspec

from valor.bags.files import BEGINNING, SUFFIX, is_own_folder, origin
from valor.bags.retention import Disk, Piece, Surplus, surplus
from valor.common import whole_file
from valor.common.bounds import Bounds
from valor.common.errors import ConfigurationError
from valor.common.table import Table, checked, plain

KEEP = "KEEP"  # a file of this name in a recording's folder: it stays
_BOUNDS = "bounds.json"  # what the last `up` was told
_LOCK = ".lock"
_TIME = "%Y-%m-%d_%H-%M-%S"
_NAME = re.compile(r"(\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d)(?:_(?P<label>[a-z]+))?(?:_\d+)?")


class Unfinished(Table):
    """What a recorder notes: the bags that it has begun, and not finished."""

    unfinished: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Recording:
    """One folder: what a recorder wrote from its start to its end.

    Attributes:
        files: its pieces, in the order in which they were written; size [B] and last change, wall clock [s].
        begun: by its name, wall clock [s].
        kept: it is marked to stay.
        label: what it was saved for (``fall``, ``snap``); empty: it holds everything.
    """

    folder: Path
    files: tuple[tuple[Path, int, float], ...]
    begun: float
    kept: bool
    label: str

    @property
    def name(self) -> str:
        """Of its folder."""
        return self.folder.name

    @property
    def size(self) -> int:
        """Of all its pieces [B]."""
        return sum(size for _, size, _ in self.files)

    @property
    def ended(self) -> float:
        """When it was written last, wall clock [s]."""
        return max(changed for _, _, changed in self.files)

    @property
    def written(self) -> bool:
        """Whether it is being written."""
        return any(_state(path) == "written" for path, _, _ in self.files)

    def finished(self) -> Iterator[Path]:
        """Pieces that a recorder of ours wrote, and writes no more."""
        return (path for path, _, _ in self.files if _state(path) == "closed")

    def pieces(self) -> Iterator[Piece]:
        """Those that a recorder of ours wrote, as retention wants to know them."""
        for path, size, changed in self.files:
            state = _state(path)
            if state != "foreign":
                yield Piece(path, size, changed, stays=self.kept or state == "written")


def name_of(moment: datetime) -> str:
    """The name of a recording that begins then."""
    return f"{moment:{_TIME}}"


def begun(name: str) -> float:
    """When a recording of that name began, wall clock [s].

    Raises:
        ValueError: no recorder gave that name.
    """
    named = _NAME.fullmatch(name)
    if not named:
        raise ValueError(f"{name}: expected a time")
    return datetime.strptime(named[1], _TIME).timestamp()


def look(bags: Path) -> list[Recording]:
    """All recordings of a folder, the oldest first. Quick: names, sizes and times alone."""
    found = []
    with contextlib.suppress(OSError), os.scandir(bags) as entries:
        for entry in entries:
            if _NAME.fullmatch(entry.name) and entry.is_dir(follow_symlinks=False):
                with contextlib.suppress(ValueError):  # a name of the thirteenth month
                    recording = _recording(Path(entry.path))
                    found += [recording] if recording.files else []
    return sorted(found, key=lambda each: (each.ended, each.name))


def _recording(folder: Path) -> Recording:
    files, kept = [], False
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            kept |= entry.name == KEEP
            if entry.name.endswith(SUFFIX) and is_own_folder(folder / entry.name):
                with contextlib.suppress(OSError):  # gone meanwhile
                    found = entry.stat(follow_symlinks=False)
                    if stat.S_ISREG(found.st_mode):
                        files.append((Path(entry.path), found.st_size, found.st_mtime))
    files.sort(key=lambda each: (each[2], each[0]))
    named = _NAME.fullmatch(folder.name)
    return Recording(folder, tuple(files), begun(folder.name), kept, (named and named["label"]) or "")


def disk_of(bags: Path) -> Disk:
    """The disk that a folder is on, or will be.

    Raises:
        OSError: it cannot be asked.
    """
    usage = shutil.disk_usage(next(path for path in (bags, *bags.parents) if path.exists()))
    return Disk(usage.total, usage.free)


def _state(bag: Path) -> Literal["written", "closed", "foreign"]:
    """A recorder holds the file that it writes locked, from before its first byte on."""
    try:
        with _opened(bag) as file:
            if file.read(len(BEGINNING)) != BEGINNING:
                return "foreign"
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return "written"
    except OSError:  # gone, a link, or not ours to read
        return "foreign"
    return "closed"


def _opened(bag: Path) -> BinaryIO:
    return open(os.open(bag, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC), "rb")


def notes_file(folder: Path) -> Path:
    """Where a recorder notes which bags it has not finished, in its instance's folder."""
    return folder / "bag_recorder.json"


def unfinished(folder: Path) -> list[Path]:
    """The bags that the recorder of an instance's folder has not finished: the one of now, and those of a crash."""
    try:
        return list(checked(Unfinished, msgspec.json.decode(notes_file(folder).read_bytes())).unfinished)
    except (OSError, ValueError):
        return []


def being_written(folder: Path) -> Path | None:
    """The bag that the recorder of an instance's folder writes now."""
    return next((bag for bag in reversed(unfinished(folder)) if _state(bag) == "written"), None)


def start_of(bag: Path) -> float:
    """When a bag began, finished or not, wall clock [s]; as good as it can be told without reading it all."""
    with contextlib.suppress(OSError, ValueError, KeyError):
        return datetime.fromisoformat(origin(bag)["started"]).timestamp()
    with contextlib.suppress(OSError):
        return bag.stat().st_mtime
    return time.time()


def pieces_of(bag: Path) -> list[Path]:
    """A bag and, if it stands in a folder of its own, those that it was split into."""
    if not is_own_folder(bag):
        return [bag]
    return [piece for piece in bag.parent.glob(f"*{SUFFIX}") if is_own_folder(piece)]


def holding(instance_folder: Path, when: float) -> Path | None:
    """The bag that holds a moment, if one does.

    Args:
        instance_folder: of the instance whose recorder wrote it.
        when: wall clock [s].
    """
    written = being_written(instance_folder)
    if written is not None and start_of(written) <= when:
        return written
    for recording in reversed(look(instance_folder / "bags")):
        from valor.bags import rosbag2_metadata  # reads YAML; whoever only looks need not wait for that

        head = rosbag2_metadata.head(recording.folder)
        start = head.start if head else recording.begun
        for path, _, changed in recording.files:
            if start <= when <= changed:
                return path
            start = changed
    return None


def keep(recording: Recording, marked: bool) -> None:
    """Mark a recording to stay, or no longer.

    Raises:
        OSError: its folder cannot be written.
    """
    if marked:
        (recording.folder / KEEP).touch()
    else:
        (recording.folder / KEEP).unlink(missing_ok=True)


def save_bounds(bags: Path, bounds: Bounds) -> None:
    """Leave for `bag prune` what recordings are to stay in.

    Raises:
        OSError: it cannot be written.
    """
    whole_file.write(bags / _BOUNDS, msgspec.json.encode(plain(bounds)))


def saved_bounds(bags: Path) -> Bounds:
    """What the last `up` was told; the defaults, if there was none.

    Raises:
        ConfigurationError: the file is not what was left there.
    """
    file = bags / _BOUNDS
    try:
        return checked(Bounds, msgspec.json.decode(file.read_bytes()))
    except FileNotFoundError:
        return Bounds()
    except (OSError, ValueError) as error:
        raise ConfigurationError(f"{file}: {' '.join(str(error).split())}") from None


@contextlib.contextmanager
def changing(bags: Path) -> Iterator[None]:
    """Hold a folder of bags while pieces of it are removed or described: one at a time. Waits for whoever is at it.

    Raises:
        OSError: the folder cannot be written.
    """
    descriptor = os.open(bags / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def too_many(bags: Path, bounds: Bounds, floor: int | None = None, now: float | None = None) -> list[Surplus]:
    """What has to go, the oldest first; see ``retention.surplus``.

    Raises:
        OSError: the disk cannot be asked.
    """
    pieces = [piece for recording in look(bags) for piece in recording.pieces()]
    return surplus(pieces, bounds, disk_of(bags), time.time() if now is None else now, floor)


def prune(bags: Path, bounds: Bounds, floor: int | None = None, now: float | None = None) -> list[Surplus]:
    """Remove what has to go. Safe beside a recorder and beside another who prunes.

    Returns:
        What went.

    Raises:
        OSError: the folder cannot be written.
    """
    with changing(bags):
        return [each for each in too_many(bags, bounds, floor, now) if _remove(each.piece)]


def _remove(piece: Piece) -> bool:
    """Remove one piece, and its recording with the last of them; whether it went."""
    from valor.bags import rosbag2_metadata

    try:
        with _opened(piece.path) as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.lexists(piece.path.parent / KEEP):  # since we looked
                return False
            piece.path.unlink()
    except (BlockingIOError, FileNotFoundError):
        return False
    folder = piece.path.parent
    with contextlib.suppress(OSError):
        if rosbag2_metadata.write(folder) is None:
            _clear(folder)
    return True


def _clear(folder: Path) -> None:
    """Remove the folder of a recording without pieces, unless somebody else has put something there."""
    from valor.bags import rosbag2_metadata

    if not any(folder.glob(f"*{SUFFIX}")):
        (folder / rosbag2_metadata.FILE).unlink(missing_ok=True)
        folder.rmdir()
