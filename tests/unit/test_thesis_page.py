"""docs/thesis.md names files and tests that exist, has every item of chapters 3 to 6, and counts its rows."""

import re
from collections import Counter

from harness.places import REPOSITORY

SECTIONS = """
    3.1 3.1.1 3.1.2 3.1.3 3.2 3.2.1 3.2.2 3.3 3.4 3.4.1 3.4.2 3.4.3 3.5
    4.1 4.1.1 4.1.2 4.1.3 4.1.4 4.2 4.2.1 4.2.2 4.3 4.3.1 4.3.2 4.3.3
    5.1 5.2 5.2.1 5.2.2 5.3 5.3.1 5.4 5.4.1 5.4.2 5.5 6.1 6.2 6.2.1
"""
FIGURES = {3: 10, 4: 4, 5: 15, 6: 1}  # number of figures by chapter
TABLES = ["Table 3.1", "Table 5.1", "Table 5.2"]
TEXT = (REPOSITORY / "docs" / "thesis.md").read_text()
ROWS = [re.split(r" *\| *", line)[1:-1] for line in TEXT.splitlines() if re.match(r"\| (\d|Figure|Table)", line)]


def test_every_file_and_test_exists() -> None:
    named = [(column, name) for row in ROWS for column in (2, 3) for name in re.findall("`([^`]+)`", row[column])]
    assert len(named) > len(ROWS)
    for column, name in named:
        path, _, function = name.partition("::")
        file = REPOSITORY / ("tests" if column == 3 else "") / path
        assert file.is_file(), name
        assert not function or f"\ndef {function}(" in file.read_text(), name


def test_every_section_figure_and_table_has_a_row() -> None:
    items = {item for row in ROWS for item in row[0].split(", ")}
    figures = [f"Figure {chapter}.{i}" for chapter, last in FIGURES.items() for i in range(1, last + 1)]
    assert items == {*SECTIONS.split(), *figures, *TABLES}


def test_the_introduction_counts_the_rows() -> None:
    assert len(ROWS) <= 112 and all(len(row) == 5 for row in ROWS)
    found = Counter(re.split("[:;]", row[4])[0] or "done" for row in ROWS)
    counted = re.search(r"(\d+) rows: (\d+) done, (\d+) deliberately different, (\d+) partial, (\d+) missing\.", TEXT)
    assert counted
    states = ("done", "different", "partial", "missing")
    assert [int(number) for number in counted.groups()] == [len(ROWS), *(found.pop(state, 0) for state in states)]
    assert not found, "a departure begins with one of these words"


def test_what_is_done_names_its_file_and_test() -> None:
    assert [row for row in ROWS if not row[4] and "–" in row[2:4]] == []
