"""Folders that are there as a whole: made beside their place, and put there when all is in them."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from valor.common.errors import ConfigurationError


def require_free(folder: Path, mark: str, kind: str, replace: bool) -> None:
    """Whether a folder may be put somewhere.

    Args:
        folder: where.
        mark: a file that every folder of the kind has.
        kind: as one says it of several.
        replace: whether one of the kind that is there makes way.

    Raises:
        ConfigurationError: something is in the way.
    """
    if not folder.exists():
        return
    if not folder.is_dir():
        raise ConfigurationError(f"{folder}: is a file; expected a new folder")
    if not any(folder.iterdir()):
        return
    if not replace:
        raise ConfigurationError(f"{folder}: is there already; expected another --out, or --force to replace it")
    if not (folder / mark).is_file():
        raise ConfigurationError(f"{folder}: --force replaces {kind} only, and this one has no {mark}")


@contextlib.contextmanager
def beside(folder: Path) -> Iterator[Path]:
    """An empty folder of the same name beside one that is to be; gone afterwards."""
    try:
        folder.absolute().parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.absolute().parent) as room:
            draft = Path(room) / folder.name
            draft.mkdir()
            yield draft
    except OSError as error:
        raise ConfigurationError(f"{folder}: {error.strerror or error}") from None


def put(draft: Path, folder: Path) -> None:
    """What is in the way goes out of it with the draft's room."""
    if folder.exists():
        shutil.move(folder, draft.with_name(f"{folder.name}.before"))
    draft.rename(folder)
