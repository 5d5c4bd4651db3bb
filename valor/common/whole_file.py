"""Files that are there as a whole: who reads one, or finds it after a crash, sees the old or the new, never half."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path


def write(file: Path, content: str | bytes) -> None:
    """Put a file in the place of what stood there, if anything did.

    Raises:
        OSError: it cannot be written; names ``file``, which is as it was, and leaves nothing beside it.
    """
    beside = file.with_name(f".{file.name}.{os.getpid()}")
    try:
        beside.write_bytes(content.encode() if isinstance(content, str) else content)
        beside.replace(file)
    except OSError as error:
        with contextlib.suppress(OSError):
            beside.unlink()
        raise OSError(error.errno, error.strerror, str(file)) from None
