"""docs/reliability.md tells only what the soak can try, what it allows, and what a test of that name holds."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from harness.places import REPOSITORY
from tests.soak import rows, rules
from tests.soak.activities import ACTIVITIES
from tests.soak.events import events
from tests.soak.run import Outcome
from valor.common.behaviors import Behavior
from valor.common.processes import BY_NAME
from valor.valorctl.profile import Profile

DURING: Mapping[str, frozenset[Behavior]] = {
    "standing": frozenset({Behavior.STAND}),
    "walking": frozenset({Behavior.WALK}),
    "stepping": frozenset({Behavior.STEP, Behavior.STAND}),  # the plan may have come to its end
    "reaching": frozenset({Behavior.STAND_MANIPULATE}),
    "soft stop": frozenset({Behavior.SOFT_STOP}),
    "frozen": frozenset({Behavior.FREEZE}),
    "fallen": frozenset({Behavior.FALL}),
}
TEXT = (REPOSITORY / "docs" / "reliability.md").read_text()
WORDS = {rows.GOES_ON, rows.NOT_WELL, *Behavior}


def measured() -> Iterator[tuple[str, list[str]]]:
    """Profile and cells of each line of the tables."""
    for part in TEXT.split("### Profile `")[1:]:
        profile = part.partition("`")[0]
        for line in re.findall(r"^\| (.+) \|$", part.partition("\n## ")[0], re.MULTILINE)[1:]:
            yield profile, line.split(" | ")


MEASURED = list(measured())


def test_there_is_something_to_read() -> None:
    assert {profile for profile, _ in MEASURED} == {"sim", "hardware"}
    assert all(len(cells) == rows.HEAD.count(" | ") + 1 for _, cells in MEASURED)


@pytest.mark.parametrize(("profile", "cells"), MEASURED, ids=lambda each: each if isinstance(each, str) else each[0])
def test_every_line_tells_what_the_soak_knows_and_allows(profile: str, cells: list[str]) -> None:
    happened, on, other, _, _ = cells
    known = events(Profile.load(REPOSITORY / "deploy" / f"{profile}.yaml").processes, own_disk=True)
    ends = [] if on == "–" else [(rows.GOES_ON, on)]
    ends += (
        []
        if other == "–"
        else [(word, robot) for word, _, robot in (each.partition(": ") for each in other.split("; "))]
    )
    assert ends and {word for word, _ in ends} <= WORDS
    for event, (word, robot) in itertools.product(happened.split(", "), ends):
        what = known[event]
        for before in (each for activity in robot.split(", ") for each in DURING[activity]):
            hit = what.hit or ("",)
            allowed = {str(after) for name in hit for after in rules.outcomes(what.kind, name, before)}
            assert word in {rows.GOES_ON, *allowed}


def test_every_activity_has_its_behaviors() -> None:
    assert set(DURING) == set(ACTIVITIES)
    assert set(BY_NAME) >= {
        name for each in events([], own_disk=True).values() if each.kind not in ("", "unplug") for name in each.hit
    }


def made(activity: str, before: str, after: str, ready: float, moved: float = 0.0) -> dict[str, Any]:
    return {"event": "wrong ROS messages", "activity": activity, "profile": "sim", "before": before, "after": after} | {
        "ready": ready,
        "moved": moved,
    }


def test_the_table_counts_and_takes_the_worst() -> None:
    outcomes = [
        made("standing", "stand", "stand", 1.0),
        made("standing", "stand", "stand", 3.0),
        made("standing", "stand", "fall", 2.0),
        made("standing", "stand", "", float("nan")),
    ]
    *_, line = rows.table(outcomes, "sim")
    assert line == ("| wrong ROS messages | standing | fall: standing; not well within 60 s: standing | 4 | 3.0 |")


def test_what_ends_in_the_same_ways_is_one_row_and_what_does_not_is_two() -> None:
    outcomes = [
        made("standing", "stand", "stand", 1.0, 0.02),
        made("walking", "walk", "walk", 2.0, 3.0),
        made("stepping", "step", "stand", 2.0, 3.0),  # the plan has come to its end
        made("standing", "stand", "stand", 0.5) | {"event": "garbage bytes"},  # measured with the other
        made("frozen", "freeze", "fall", 4.0, 3.0) | {"event": "malformed messages"},
        made("standing", "stand", "stand", 9.0) | {"event": "push"},  # not measured
    ]
    *_, first, second = rows.table(outcomes, "sim")
    assert first == "| garbage bytes, wrong ROS messages | standing, walking, stepping | – | 4 | 2.0 |"
    assert second == "| malformed messages | – | fall: frozen | 1 | 4.0 |"


def test_the_farthest_is_of_joints_that_are_to_stay() -> None:
    outcomes = [
        made("standing", "stand", "stand", 1.0, 0.01),
        made("soft stop", "soft_stop", "soft_stop", 1.0, 0.02),
        made("walking", "walk", "walk", 2.0, 3.0),
        made("frozen", "freeze", "fall", 4.0, 3.0),
    ]
    assert rows.farthest(outcomes, "sim") == 0.02
    assert math.isnan(rows.farthest(outcomes, "hardware"))


def test_what_was_measured_least_comes_first_and_what_was_measured_enough_not_again(tmp_path: Path) -> None:
    file = tmp_path / "measured.jsonl"
    for activity in ("standing", "standing", "walking"):
        rows.add(file, "sim", Outcome(activity, "push"))
    rows.add(file, "hardware", Outcome("walking", "push"))
    wanted = ["standing/push", "walking/push", "frozen/push"]
    again = [row for row, _ in rows.to_do(file, "sim", wanted, 2)]
    assert again == ["frozen/push", "walking/push", "frozen/push"]


def test_every_row_to_measure_is_of_the_tables() -> None:
    for profile in ("sim", "hardware"):
        known = events(Profile.load(REPOSITORY / "deploy" / f"{profile}.yaml").processes, own_disk=True)
        for row in rows.everything(known):
            activity, _, event = row.partition("/")
            assert activity in ACTIVITIES and event in known
        for name, _ in rows.MEASURED:
            assert profile == "sim" or any(re.fullmatch(name, event) for event in known), name


def test_tests_that_hold_rows_exist() -> None:
    for (event, activity, profile), name in rows.HELD_BY.items():
        known = events(Profile.load(REPOSITORY / "deploy" / f"{profile}.yaml").processes, own_disk=True)
        assert f"{activity}/{event}" in rows.everything(known)
        file, _, test = name.partition("::")
        assert f"def {test}(" in (REPOSITORY / file).read_text()
