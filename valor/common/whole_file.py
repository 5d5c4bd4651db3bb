"""Atomic replacement of files: a reader, also after a crash, finds the old or the new content, never a part."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path


def write(file: Path, content: str | bytes) -> None:
    """Create or replace a file. Raises OSError with its name; it is then unchanged, and no temporary file remains."""
    try:
        with replacing(file) as beside:
            beside.write_bytes(content.encode() if isinstance(content, str) else content)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(file)) from None


@contextlib.contextmanager
def replacing(file: Path) -> Iterator[Path]:
    """Temporary path that replaces ``file`` at the end of the block; removed if the block fails."""
    beside = file.with_name(f".{file.name}.{os.getpid()}")
    try:
        yield beside
        beside.replace(file)
    except BaseException:
        with contextlib.suppress(OSError):
            beside.unlink()
        raise
