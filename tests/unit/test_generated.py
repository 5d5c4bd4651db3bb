"""What is written out of the tables and messages is what they say."""

from pathlib import Path

import pytest

from harness.generate import PLACES, texts
from harness.places import REPOSITORY

WRITTEN = texts()


@pytest.mark.parametrize("path", sorted(WRITTEN), ids=lambda path: path.name)
def test_what_is_written_out_is_not_stale(path: Path) -> None:
    assert path.read_text() == WRITTEN[path], "run `make tables`"


def test_all_that_is_written_stands_in_its_place() -> None:
    for written, place in PLACES.items():
        assert written() in (REPOSITORY / place).read_text()
