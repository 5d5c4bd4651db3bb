"""docs/reliability.md tells only what the soak can try, what it allows, and what a test of that name holds."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache

import pytest

from tests.conftest import REPOSITORY
from tests.soak import rows, rules
from tests.soak.activities import ACTIVITIES
from tests.soak.events import events
from valor.common.processes import BY_NAME
from valor.motion_manager.behaviors import Behavior
from valor.valorctl.profile import Profile

DURING: Mapping[str, frozenset[Behavior]] = {
    "standing": frozenset({Behavior.STAND}),
    "walking": frozenset({Behavior.WALK}),
    "stepping": frozenset({Behavior.STEP, Behavior.STAND}),  # the plan may have come to its end
    "arm on its way": frozenset({Behavior.STAND_MANIPULATE}),
    "soft stop": frozenset({Behavior.SOFT_STOP}),
    "frozen": frozenset({Behavior.FREEZE}),
    "fallen": frozenset({Behavior.FALL}),
}
TABLE = re.findall(r"^\| (.+) \|$", (REPOSITORY / "docs" / "reliability.md").read_text(), re.MULTILINE)
MEASURED = [line.split(" | ") for line in TABLE if line.count(" | ") == rows.HEAD.count(" | ")][1:]


@cache
def defined() -> set[str]:
    """Names of all tests."""
    files = (REPOSITORY / "tests").rglob("test_*.py")
    return {name for file in files for name in re.findall(r"^def (test_\w+)", file.read_text(), re.MULTILINE)}


def test_there_is_something_to_read() -> None:
    assert len(MEASURED) > 1


@pytest.mark.parametrize("row", MEASURED, ids=lambda row: "/".join(row[:3]))
def test_every_row_is_one_that_the_soak_knows_and_allows(row: list[str]) -> None:
    event, activity, profile, then, _, _, test = row
    assert activity in ACTIVITIES
    known = events(Profile.load(REPOSITORY / "deploy" / f"{profile}.yaml").processes)
    assert event in known
    what = known[event]
    before = DURING[activity]
    allowed = frozenset().union(*(rules.outcomes(what.kind, what.process, each) for each in before))
    assert {Behavior(each.split()[0]) for each in then.split(", ")} <= allowed
    assert test.strip("`") in defined()


def test_every_activity_has_its_behaviors() -> None:
    assert set(DURING) == set(ACTIVITIES)
    assert set(BY_NAME) >= {each.process for each in events([]).values() if each.kind}


def test_the_table_counts_and_takes_the_middle_and_the_worst() -> None:
    made = [
        {"event": "push", "activity": "standing", "profile": "sim", "after": after, "ready": ready}
        for after, ready in (("stand", 1.0), ("stand", 3.0), ("fall", 2.0), ("", float("nan")))
    ]
    *_, line = rows.table(made)
    assert "| stand 2, fall 1, not well within 60 s 1 | 2.0, 3.0 | 4 |" in line


def test_tests_that_hold_rows_exist() -> None:
    for name in (*rows.HELD_BY.values(), rows.SOAK):
        file, _, test = name.partition("::")
        assert f"def {test}(" in (REPOSITORY / file).read_text()
