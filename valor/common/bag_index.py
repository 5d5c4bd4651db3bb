"""A bag's index: the summary section at the end of an MCAP file that was finished."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from struct import error as StructError  # noqa: N812

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Statistics
from mcap.summary import Summary

from valor.common.errors import ValorError


class BagError(ValorError):
    """A file is no bag, or cannot be read or recovered: names the file and why."""


@dataclass(frozen=True)
class BagIndex:
    """What a bag holds: channels and schemas, and how many messages from when to when."""

    summary: Summary
    statistics: Statistics


def read_index(bag: Path) -> BagIndex | None:
    """The index of a bag; None if it is whole but has none.

    Raises:
        BagError: it is no MCAP file, or was cut off or damaged.
        OSError: it cannot be read.
    """
    try:
        with open(bag, "rb") as file:
            summary = make_reader(file).get_summary()
    except (McapError, ValueError, StructError):
        raise BagError(f"{bag}: not a whole MCAP file") from None
    if summary is None or summary.statistics is None:
        return None
    return BagIndex(summary, summary.statistics)
