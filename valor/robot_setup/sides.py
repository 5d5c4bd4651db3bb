"""Which side is left, where geometry leaves it open: what names say, and who is asked."""

from __future__ import annotations

import re
from collections.abc import Iterable

from valor.robot_setup.questions import Ask, Question
from valor.robot_setup.source import Source

_NAMED = re.compile(  # left or right as a word of a name: l_hip, LHipYaw, hipLeft
    r"(?:^|[^a-zA-Z])(?:([lL]eft|LEFT|[lL])|([rR]ight|RIGHT|[rR]))(?=$|[^a-z])"
    r"|(?<=[a-z])(?:(Left|L)|(Right|R))(?=$|[^a-z])"
)


def said_left(names: Iterable[str]) -> int:
    """How many more names say left than right."""
    found = [match for name in names if (match := _NAMED.search(name))]
    return sum(1 if match[1] or match[3] else -1 for match in found)


def feet_are_right(source: Source, ask: Ask) -> bool:
    """Whether forward is where the feet reach, though names then have left and right the other way around."""
    text = "the feet reach forward one way, and names say left and right the other way around: who is right"
    feet = ask(Question(text, "feet", ("feet", "names"))) == "feet"
    known = "where the feet reach" if feet else "as names say left and right"
    source.notes.append(f"Guessed: forward is {known}; names and feet contradict each other.")
    return feet
