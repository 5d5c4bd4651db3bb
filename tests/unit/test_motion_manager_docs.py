"""The tables in docs/motion_manager.md are those of the code."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import StrEnum
from typing import Any

import pytest

from harness.places import REPOSITORY
from valor.common.behaviors import INTERNAL_STATES, Attention, Behavior, Manipulation
from valor.motion_manager.states.transitions import (
    ATTENTION_TRANSITIONS,
    BEHAVIOR_TRANSITIONS,
    JOINT_ACCESS,
    MANIPULATION_TRANSITIONS,
)

# Those of Locomotion follow from the behaviors' (test_behavior_tables), and the page says so.
TRANSITIONS: dict[type[StrEnum], Mapping[Any, Any]] = {
    Manipulation: MANIPULATION_TRANSITIONS,
    Attention: ATTENTION_TRANSITIONS,
}


def rows(*cells: tuple[str, ...]) -> str:
    header, *body = ("| " + " | ".join(row) + " |" for row in cells)
    return "\n".join([header, "|" + "---|" * len(cells[0]), *body])


def names(states: Iterable[str]) -> str:
    return ", ".join(f"`{state}`" for state in states)


def edges(row: Mapping[Any, str]) -> str:
    """Where a row leads, by source."""
    sources = dict.fromkeys(sorted(row.values(), key=("T", "P", "I", "I2").index))
    return "; ".join(f"{source}: {names(there for there in row if row[there] == source)}" for source in sources)


def behaviors() -> str:
    return rows(
        ("from", "Locomotion, Manipulation, Attention", "to"),
        *((f"`{each}`", names(INTERNAL_STATES[each]), edges(BEHAVIOR_TRANSITIONS[each])) for each in Behavior),
    )


def machines() -> str:
    def to(machine: type[StrEnum]) -> str:
        table = TRANSITIONS.get(machine, {})
        return ". ".join(f"`{here}` → {edges(row)}" for here, row in table.items()) or "as above"

    return rows(
        ("FSM", "groups of robot.yaml that it moves", "edges"),
        *((machine.__name__, names(JOINT_ACCESS[machine]), to(machine)) for machine in JOINT_ACCESS),
    )


TABLES = {"behaviors": behaviors(), "machines": machines()}


@pytest.mark.parametrize("table", TABLES)
def test_the_page_has_the_table_of_the_code(table: str) -> None:
    assert TABLES[table] in (REPOSITORY / "docs" / "motion_manager.md").read_text()
