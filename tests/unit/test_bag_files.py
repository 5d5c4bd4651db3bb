"""A bag's first bytes: as the MCAP library writes them, in full and cut off anywhere."""

from __future__ import annotations

from pathlib import Path

import hypothesis.strategies as st
import pytest
from hypothesis import given
from mcap.writer import Writer

from harness.examples import examples
from valor.bags.files import BEGINNING, LIBRARY, PROFILE, origin

TEXTS = st.dictionaries(st.text(max_size=20), st.text(max_size=20), max_size=5)


def written(file: Path, values: dict[str, str]) -> bytes:
    with open(file, "wb") as out:
        writer = Writer(out)
        writer.start(PROFILE, LIBRARY)
        writer.add_metadata("origin", values)
        writer.finish()
    return file.read_bytes()


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("bags") / "walk.mcap"


@examples(50)
@given(values=TEXTS)
def test_what_the_library_writes_is_read(file: Path, values: dict[str, str]) -> None:
    assert written(file, values).startswith(BEGINNING)
    assert origin(file) == values


@examples(50)
@given(values=TEXTS.filter(bool), data=st.data())
def test_what_is_cut_off_or_damaged_is_not_there_and_no_error(
    file: Path, values: dict[str, str], data: st.DataObject
) -> None:
    whole = written(file, values)
    end = len(BEGINNING) + 9 + int.from_bytes(whole[len(BEGINNING) + 1 :][:8], "little")  # of the record
    cut = data.draw(st.integers(len(BEGINNING), end - 1), "cut")
    file.write_bytes(whole[:cut])
    assert origin(file) == {}
    garbage = data.draw(st.binary(max_size=80), "garbage")
    file.write_bytes(BEGINNING + garbage)
    origin(file)
