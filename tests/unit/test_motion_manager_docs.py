"""The tables in docs/motion_manager.md are those of the code."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum

import pytest

from harness.places import REPOSITORY
from valor.common.behaviors import INTERNAL_STATES, Behavior
from valor.motion_manager.states.transitions import (
    ATTENTION_TRANSITIONS,
    BEHAVIOR_TRANSITIONS,
    JOINT_ACCESS,
    LOCOMOTION_TRANSITIONS,
    MANIPULATION_TRANSITIONS,
)


def rows(*cells: tuple[str, ...]) -> str:
    header, *body = ("| " + " | ".join(row) + " |" for row in cells)
    return "\n".join([header, "|" + "---|" * len(cells[0]), *body])


def behaviors() -> str:
    def cell(here: Behavior, there: Behavior) -> str:
        return "–" if here is there else BEHAVIOR_TRANSITIONS[here].get(there, "·")

    return rows(
        ("from \\ to", *(f"`{there}`" for there in Behavior)),
        *((f"`{here}`", *(cell(here, there) for there in Behavior)) for here in Behavior),
    )


def edges(name: str, table: Mapping[StrEnum, Mapping[StrEnum, str]]) -> str:
    lines = (
        (f"`{here}`", ", ".join(f"`{there}` {source}" for there, source in row.items())) for here, row in table.items()
    )
    return rows((f"{name}: from", "to"), *lines)


def tables() -> dict[str, str]:
    machines: dict[str, Mapping] = {  # type: ignore[type-arg]
        "Locomotion": LOCOMOTION_TRANSITIONS,
        "Manipulation": MANIPULATION_TRANSITIONS,
        "Attention": ATTENTION_TRANSITIONS,
    }
    return {
        "behaviors": behaviors(),
        "internal": rows(
            ("behavior", "Locomotion", "Manipulation", "Attention"),
            *((f"`{behavior}`", *(f"`{state}`" for state in states)) for behavior, states in INTERNAL_STATES.items()),
        ),
        "machines": "\n\n".join(edges(name, table) for name, table in machines.items()),
        "access": rows(
            ("FSM", "groups of robot.yaml"),
            *(
                (machine.__name__, ", ".join(f"`{group}`" for group in groups))
                for machine, groups in JOINT_ACCESS.items()
            ),
        ),
    }


@pytest.mark.parametrize("table", tables())
def test_the_page_has_the_table_of_the_code(table: str) -> None:
    page = (REPOSITORY / "docs" / "motion_manager.md").read_text()
    assert tables()[table] in page
