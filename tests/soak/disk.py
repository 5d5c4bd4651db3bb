"""A disk of the soak's own, small enough to be filled."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

SIZE = 2 << 30  # [byte]; of it recordings keep a tenth
_BALLAST = "ballast"


def mount(folder: Path) -> bool:
    """Lay a file system of its own over an empty folder, in memory; returns whether that is allowed here."""
    command = ["mount", "-t", "tmpfs", "-o", f"size={SIZE},mode=0700", "soak", str(folder)]
    try:
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        return False


def leave(folder: Path, keep: bool) -> Path | None:
    """Take the folder away, mounted or not; returns where what it held is kept, if it shall be."""
    kept = folder.with_name(f"{folder.name}-kept") if keep else None
    if kept:
        shutil.copytree(folder, kept, ignore=shutil.ignore_patterns(_BALLAST))
    if os.path.ismount(folder):
        subprocess.run(["umount", "--lazy", str(folder)], check=True)
    shutil.rmtree(folder)
    return kept


def fill(folder: Path) -> None:
    """Leave not a byte of it free."""
    ballast = folder / _BALLAST
    with open(ballast, "wb") as file:
        size = 0
        for block in (64 << 20, 1 << 20, 4096):
            try:
                while True:
                    os.posix_fallocate(file.fileno(), size, block)
                    size += block
            except OSError:  # no room for one more
                continue


def empty(folder: Path) -> None:
    """Give back what ``fill`` has taken."""
    (folder / _BALLAST).unlink(missing_ok=True)
