"""What is written out of the tables and messages is what they say."""

from __future__ import annotations

from pathlib import Path

import pytest

from valor.common.generate import REPOSITORY, TABLES, texts


@pytest.mark.parametrize("path", [path for path in texts() if path.suffix == ".md"], ids=lambda path: path.name)
def test_what_is_written_out_is_not_stale(path: Path) -> None:
    assert path.read_text() == texts()[path], "run `make tables`"


def test_every_table_stands_on_its_page() -> None:
    for table, page in TABLES.items():
        assert table() in (REPOSITORY / page).read_text()
