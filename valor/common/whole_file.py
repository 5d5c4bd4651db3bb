"""Files that are there as a whole: who reads one, or finds it after a crash, sees the old or the new, never half."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path


def write(file: Path, content: str | bytes) -> None:
    """Put a file in the place of what stood there, if anything did.

    Raises:
        OSError: it cannot be written; names ``file``, which is as it was, and leaves nothing beside it.
    """
    try:
        with replacing(file) as beside:
            beside.write_bytes(content.encode() if isinstance(content, str) else content)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(file)) from None


@contextlib.contextmanager
def replacing(file: Path) -> Iterator[Path]:
    """Where to write what takes the place of ``file`` when the block ends; nothing is left there if it fails."""
    beside = file.with_name(f".{file.name}.{os.getpid()}")
    try:
        yield beside
        beside.replace(file)
    except BaseException:
        with contextlib.suppress(OSError):
            beside.unlink()
        raise
