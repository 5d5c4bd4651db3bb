"""Which recordings go, oldest first, so that all together stay within bounds: of age, of size, of the disk.

Nothing here touches a file: ``recordings.py`` says what there is, and removes it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from valor.common.bounds import DAY, Bounds

RESERVE = 1 << 30  # free space, or a tenth of the disk, below which the oldest makes room for the newest [B]
# Before it nothing of ours was recorded: a file that is dated so had a computer without a clock, and no known age [s].
_EPOCH = 1_577_836_800.0  # 2020-01-01


@dataclass(frozen=True)
class Piece:
    """One file of a recording.

    Attributes:
        ended: when it was written last, wall clock [s].
        stays: whatever the bounds: it is being written, or its recording is marked to be kept.
    """

    path: Path
    size: int  # [B]
    ended: float
    stays: bool


@dataclass(frozen=True)
class Disk:
    """What ``shutil.disk_usage`` says of the disk under the recordings [B]."""

    capacity: int
    free: int

    @property
    def reserve(self) -> int:
        """What recordings leave free, as far as it is they who take it [B]."""
        return min(RESERVE, self.capacity // 10)


@dataclass(frozen=True)
class Surplus:
    """A piece that goes, and why."""

    piece: Piece
    why: str


def surplus(pieces: Sequence[Piece], bounds: Bounds, disk: Disk, now: float, floor: int | None = None) -> list[Surplus]:
    """What goes, the oldest first.

    Args:
        pieces: all that there are.
        bounds: what they are to stay in.
        disk: that they are on.
        now: wall clock [s].
        floor: what is left, at least, of what goes for want of free space alone [B]: what other programs fill the disk
            with costs no recording that was there before. None: nothing goes for that.
    """
    in_order = sorted((piece for piece in pieces if not piece.stays), key=lambda each: (each.ended, each.path))
    oldest = [] if bounds.age is None else [each for each in in_order if _EPOCH < each.ended < now - bounds.age]
    going = [Surplus(each, f"older than {(bounds.age or 0.0) / DAY:g} d") for each in oldest]
    left = sum(piece.size for piece in pieces) - sum(piece.size for piece in oldest)
    free, limit = disk.free + sum(piece.size for piece in oldest), bounds.limit(disk.capacity)
    for piece in in_order:
        if piece in oldest:
            continue
        if limit is not None and left > limit:
            why = f"more than {limit / 1e6:g} MB in all"
        elif floor is not None and free < disk.reserve and left - piece.size >= floor:
            why = f"less than {disk.reserve >> 20} MiB were free"
        else:
            break
        going.append(Surplus(piece, why))
        left -= piece.size
        free += piece.size
    return going
