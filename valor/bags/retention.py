"""Retention: removal of the oldest pieces of recordings, so that all stay within bounds of age, size and disk.

Only pieces that a recorder of this product wrote are removed.
"""

import contextlib
import fcntl
import math
import os
import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import msgspec

from valor.bags import recordings
from valor.bags.files import SUFFIX
from valor.bags.recordings import Piece
from valor.common import whole_file
from valor.common.errors import ConfigurationError
from valor.common.instance import DAY, Bounds
from valor.common.table import checked, plain

RESERVE = 1 << 30  # free space below which the oldest piece is removed, at most a tenth of the disk [B]
_EPOCH = 1_577_836_800.0  # 2020-01-01: an earlier date comes from a computer without a clock, so the age is unknown [s]
_BOUNDS = "bounds.json"  # bounds of the last `up`
_LOCK = ".lock"


@dataclass(frozen=True)
class Disk:
    """Capacity and free space of the disk under the recordings [B], as ``shutil.disk_usage`` reports them."""

    capacity: int
    free: int

    @property
    def reserve(self) -> int:
        """Free space that recordings leave to other programs [B]."""
        return min(RESERVE, self.capacity // 10)


class Surplus(NamedTuple):
    """A piece to remove, and the reason."""

    piece: Piece
    why: str


def surplus(
    pieces: Sequence[Piece], total: int, bounds: Bounds, disk: Disk, *, now: float, floor: int | None = None
) -> list[Surplus]:
    """The pieces to remove, the oldest first.

    Args:
        pieces: that may be removed: no recorder writes them, and they are not marked to be kept.
        total: size of all pieces [B].
        bounds: of all pieces together.
        disk: that holds the pieces.
        now: wall clock [s].
        floor: total size at which removal for lack of free space stops [B], so that other programs that fill the disk
            cost no recording that existed before. None: lack of free space removes nothing.
    """
    age = math.inf if bounds.age is None else bounds.age
    aged = [piece for piece in pieces if _EPOCH < piece.ended < now - age]
    going = []
    free, limit = disk.free, bounds.limit(disk.capacity)
    for piece in sorted(pieces, key=lambda each: (each not in aged, each.ended, each.path)):
        if piece in aged:
            why = f"older than {age / DAY:g} d"
        elif limit is not None and total > limit:
            why = f"more than {limit / 1e6:g} MB in all"
        elif floor is not None and free < disk.reserve and total - piece.size >= floor:
            why = f"less than {disk.reserve >> 20} MiB were free"
        else:
            break
        going.append(Surplus(piece, why))
        total -= piece.size
        free += piece.size
    return going


def disk_of(bags: Path) -> Disk:
    """The disk of a folder that may not exist yet; raises ``OSError`` if it cannot be queried."""
    usage = shutil.disk_usage(next(path for path in (bags, *bags.parents) if path.exists()))
    return Disk(usage.total, usage.free)


def save_bounds(bags: Path, bounds: Bounds) -> None:
    """Store the bounds of `up` for `bag prune`; raises ``OSError`` if the file cannot be written."""
    whole_file.write(bags / _BOUNDS, msgspec.json.encode(plain(bounds)))


def saved_bounds(bags: Path) -> Bounds:
    """The bounds of the last `up`, or the defaults; raises ``ConfigurationError`` if the file is malformed."""
    file = bags / _BOUNDS
    try:
        return checked(Bounds, msgspec.json.decode(file.read_bytes()))
    except FileNotFoundError:
        return Bounds()
    except (OSError, ValueError) as error:
        raise ConfigurationError(f"{file}: {' '.join(str(error).split())}") from None


@contextlib.contextmanager
def changing(bags: Path) -> Iterator[None]:
    """Lock a folder of bags while pieces are removed or described, waiting for other holders. Raises ``OSError``."""
    descriptor = os.open(bags / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def too_many(bags: Path, bounds: Bounds, floor: int | None = None, now: float | None = None) -> list[Surplus]:
    """The pieces of a folder to remove; see ``surplus``. Raises ``OSError`` if the disk cannot be queried."""
    found = recordings.look(bags)
    files = [(piece, recording.kept, recordings.state(piece.path)) for recording in found for piece in recording.files]
    pieces = [piece for piece, kept, state in files if not kept and state == "closed"]
    total = sum(piece.size for piece, _, state in files if state != "foreign")
    return surplus(pieces, total, bounds, disk_of(bags), now=time.time() if now is None else now, floor=floor)


def prune(bags: Path, bounds: Bounds, floor: int | None = None, now: float | None = None) -> list[Surplus]:
    """Remove and return the surplus pieces of a folder, also while recorders or other calls use the folder.

    Raises OSError: the folder cannot be written.
    """
    with changing(bags):
        return [each for each in too_many(bags, bounds, floor, now) if _remove(each.piece)]


def _remove(piece: Piece) -> bool:
    """Remove one piece, and its recording's folder with the last piece; returns whether the piece was removed."""
    from valor.bags import rosbag2_metadata  # imports YAML and MCAP, which a caller without surplus does not need

    folder = piece.path.parent
    try:
        with recordings.opened(piece.path) as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.lexists(folder / recordings.KEEP):  # marked since the folder was listed
                return False
            piece.path.unlink()
    except (BlockingIOError, FileNotFoundError):
        return False
    with contextlib.suppress(OSError):
        if rosbag2_metadata.write(folder) is None and not any(folder.glob(f"*{SUFFIX}")):
            (folder / rosbag2_metadata.FILE).unlink(missing_ok=True)
            folder.rmdir()  # fails if another program stores files there
    return True
