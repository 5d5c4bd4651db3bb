"""Verbs of valorctl on the link: what travels, what it costs, and that states and answers go before it."""

from __future__ import annotations

import random

import numpy as np
import pytest

from harness.link_pair import STEP
from tests.unit.link.test_link import pair
from valor.common.processes import BY_NAME
from valor.link.classes import ALWAYS_ON, Kind
from valor.link.errors import SealError
from valor.link.verbs import LONGEST, pack_said, pack_verb, read_said, read_verb


def test_what_is_sent_comes_back() -> None:
    words = ["logs", "footstep_converter", "", "20", "ünïcode"]
    assert read_verb(pack_verb(words)) == words
    assert read_said(pack_said(1, "not ended: motion_manager")) == (1, "not ended: motion_manager")
    rows = "".join(f'["{name}","ready",{4000 + place},3,90,0,""],' for place, name in enumerate(BY_NAME))
    assert len(pack_said(0, rows)) < 14 * len(BY_NAME), "a status is short enough for the slow channel"


def test_what_is_too_long_is_said_and_not_sent() -> None:
    text = random.Random(0).randbytes(LONGEST).hex()
    status, said = read_said(pack_said(0, text))
    assert status == 1 and said.startswith(f"said {len(text)} characters; expected")


@pytest.mark.parametrize("data", [b"", b"\xff\xff\xff", pack_said(0, "no list")[1:], pack_said(0, "[1]")[1:]])
def test_bytes_that_are_no_verb_are_refused(data: bytes) -> None:
    with pytest.raises(SealError, match="verb"):
        read_verb(data)


def test_a_long_answer_takes_what_states_and_answers_leave() -> None:
    link = pair()
    link.until(lambda: link.operator.states > 3, 10.0)
    report = random.Random(1).randbytes(2000)
    link.robot.send(Kind.REPORT, report, link.robot_time)
    began, passed = link.now, sum(line.passed for line in link.lines.values())
    came, number = [], link.operator.states
    link.operator.send(Kind.COMMAND, b"mode", link.now)
    while report not in link.answers:
        link.step()
        came += [link.now] * (link.operator.states - number)
        number = link.operator.states
        assert link.now < began + 60.0
    assert sum(line.passed for line in link.lines.values()) - passed <= ALWAYS_ON * (link.now - began + STEP)
    whole = int(link.now - began)
    assert np.histogram(came, began + np.arange(whole + 1))[0].min() >= 8
    assert link.answers.index(b"mode") < link.answers.index(report)
