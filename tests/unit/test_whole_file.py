"""A file is replaced completely, or stays unchanged."""

import resource
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from valor.common import whole_file

pytestmark = pytest.mark.portable


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


def test_a_reader_of_the_old_file_continues_to_read_it(tmp_path: Path) -> None:
    file = tmp_path / "settings.json"
    whole_file.write(file, "old")
    with open(file) as old:
        whole_file.write(file, b"new, and longer")
        assert old.read() == "old"
    assert file.read_text() == "new, and longer" and list(tmp_path.iterdir()) == [file]


def test_a_failed_write_leaves_the_old_file_only(tmp_path: Path) -> None:
    file = tmp_path / "settings.json"
    whole_file.write(file, "old")
    with pytest.raises(OSError, match="File too large") as raised, full_disk():
        whole_file.write(file, bytes(4096))
    assert raised.value.filename == str(file) and file.read_text() == "old" and list(tmp_path.iterdir()) == [file]


def test_a_missing_folder_is_reported_with_the_files_name(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as raised:
        whole_file.write(tmp_path / "none/settings.json", "")
    assert raised.value.filename == str(tmp_path / "none/settings.json")
