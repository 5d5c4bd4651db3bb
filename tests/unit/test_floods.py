"""What is told of senders that send too much: each by name, once, while it goes on and a little longer."""

from __future__ import annotations

from dataclasses import dataclass

from hypothesis import given
from hypothesis import strategies as st

from bifrost.limits import MUTE
from harness.examples import examples
from valor.common.floods import REMEMBERED, Floods


@dataclass
class Topic:
    """An input, and whom it does not listen to now."""

    topic: str
    muted: tuple[str, ...] = ()


class Time:
    """What a clock would say [s]."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@given(st.lists(st.tuples(st.floats(0.0, 2.0), st.sets(st.sampled_from("abc")), st.sets(st.sampled_from("abc")))))
@examples(100)
def test_who_was_muted_within_the_time_is_told(periods: list[tuple[float, set[str], set[str]]]) -> None:
    clock, topics = Time(), (Topic("motor"), Topic("plan"))
    floods = Floods(topics, clock)
    last: dict[str, float] = {}
    for passed, *muted in periods:
        clock.now += passed
        for each, names in zip(topics, muted, strict=True):
            each.muted = tuple(names)
            last |= {f"{name} floods {each.topic}": clock.now for name in names}
        told = floods.told()
        expected = sorted(flood for flood, at in last.items() if clock.now - at < REMEMBERED)
        assert told == (f"{', '.join(expected)}: muted while it goes on" if expected else "")


def test_nobody_is_told_of_who_keeps_within_bounds() -> None:
    assert Floods([Topic("motor")]).told() == ""


def test_one_who_goes_on_is_told_without_a_break() -> None:
    assert REMEMBERED > MUTE, "between one muting and the next he is heard for a moment"
