"""Which command lines are nothing but a ``stop``, or a ``status``."""

from __future__ import annotations

import pytest

from valor.common.stopping import HALT, LOCK, Goal
from valor.valorctl.plain_command import plain_command
from valor.valorctl.stopping import command_line


@pytest.mark.parametrize(
    ("words", "name", "goal", "json"),
    [
        ("stop", "default", HALT, False),
        ("stop --freeze", "default", LOCK, False),
        ("--instance two stop --json", "two", HALT, True),
        ("stop --json --instance two --freeze", "two", LOCK, True),
    ],
)
def test_a_plain_stop_is_known(words: str, name: str, goal: Goal, json: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("VALOR_INSTANCE", raising=False)
    found = command_line(words.split())
    assert found is not None
    assert (found[0].name, *found[1:]) == (name, goal, json)


@pytest.mark.parametrize("words", ["stop -h", "stop --frieze", "restart stop", "stop --instance", "stop now", ""])
def test_what_is_more_or_less_is_for_the_command_line_as_a_whole(words: str) -> None:
    assert command_line(words.split()) is None


@pytest.mark.parametrize("words", ["status", "--instance two status", "status --json", "status --instance two --json"])
def test_a_plain_status_is_known(words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("VALOR_INSTANCE", raising=False)
    found = plain_command(words.split(), "status", ("--json",))
    assert found is not None
    assert found[0].name == ("two" if "two" in words else "default")
    assert found[1] == ({"--json"} if "--json" in words else set())


@pytest.mark.parametrize("words", ["status --watch", "status -h", "logs status", "--instance=two status"])
def test_a_status_that_asks_for_more_is_for_the_command_line_as_a_whole(words: str) -> None:
    assert plain_command(words.split(), "status", ("--json",)) is None
