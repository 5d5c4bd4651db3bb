"""What neither topology nor geometry tells is asked: with a guess, and the choices where there are few."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Question:
    """One line for a person.

    Attributes:
        text: without a question mark.
        guess: what is taken unless somebody knows better.
        choices: what it can be; empty: any name.
    """

    text: str
    guess: str
    choices: tuple[str, ...] = ()


Ask = Callable[[Question], str]
Tell = Callable[[str], None]


def guess(question: Question) -> str:
    """Ask nobody."""
    return question.guess


def silent(_: str) -> None:
    """Tell nobody how it goes on."""
