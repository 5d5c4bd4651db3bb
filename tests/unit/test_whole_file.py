"""A file is replaced as a whole, or stays as it was."""

from __future__ import annotations

import resource
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from valor.common import whole_file


@contextmanager
def full_disk() -> Iterator[None]:
    """No file of this process may grow beyond a kilobyte."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1024, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, before)


def test_a_reader_who_has_the_old_file_open_goes_on_reading_that(tmp_path: Path) -> None:
    file = tmp_path / "settings.json"
    whole_file.write(file, "old")
    with open(file) as old:
        whole_file.write(file, b"new, and longer")
        assert old.read() == "old"
    assert file.read_text() == "new, and longer"
    assert list(tmp_path.iterdir()) == [file]


def test_what_cannot_be_written_leaves_the_old_and_nothing_beside_it(tmp_path: Path) -> None:
    file = tmp_path / "settings.json"
    whole_file.write(file, "old")
    with pytest.raises(OSError, match="File too large") as raised, full_disk():
        whole_file.write(file, bytes(4096))
    assert raised.value.filename == str(file)
    assert file.read_text() == "old"
    assert list(tmp_path.iterdir()) == [file]


def test_a_folder_that_is_not_there_is_told_by_the_name_of_the_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as raised:
        whole_file.write(tmp_path / "none/settings.json", "")
    assert raised.value.filename == str(tmp_path / "none/settings.json")
