"""The emulated link: a seed is a history, bandwidth is kept, blackouts are blackouts; real sockets carry the same."""

import socket
import statistics
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.examples import examples
from harness.link_pair import secrets_of_both
from harness.waiting import wait_until
from valor.link.carrier import Carrier
from valor.link.classes import HEADERS, OPERATOR, ROBOT, Kind
from valor.link.emulate import Emulator
from valor.link.emulator import DRC_FAST, DRC_SLOW, Bandwidth, Conditions, Line
from valor.link.end import Arrived, End
from valor.link.schedule import drc_windows, random_windows
from valor.link.session import Session


@examples(50)
@given(st.integers(0, 2**32), st.lists(st.integers(1, 1200), max_size=30))
def test_a_seed_is_a_history(seed: int, sizes: list[int]) -> None:
    bad = Conditions(bandwidth=9600.0, delay=0.1, jitter=0.1, loss=0.2, duplication=0.2, reordering=0.2)
    first, second = Line(bad, seed), Line(bad, seed)
    assert [first.put(size, 0.1 * i) for i, size in enumerate(sizes)] == [
        second.put(size, 0.1 * i) for i, size in enumerate(sizes)
    ]


def test_both_ways_share_a_bandwidth_and_it_is_kept() -> None:
    shared = Bandwidth(DRC_SLOW)
    lines = [Line(DRC_SLOW, seed, None, shared) for seed in range(2)]
    came = [at for i in range(200) for at in lines[i % 2].put(92, 0.05 * i)]
    passed = sum(line.passed for line in lines)
    assert passed == len(came) * (92 + HEADERS)
    assert passed <= 1200 * max(came) and any(line.lost for line in lines)


def test_what_is_asked_for_happens_about_as_often() -> None:
    line = Line(Conditions(delay=0.2, jitter=0.1, loss=0.3, duplication=0.1, reordering=0.1, held=1.0), 1)
    fates = [line.put(100, float(i)) for i in range(4000)]
    assert 0.27 < sum(not fate for fate in fates) / 4000 < 0.33
    assert 0.05 < sum(len(fate) == 2 for fate in fates) / 4000 < 0.09
    delays = [fate[0] - i for i, fate in enumerate(fates) if fate]
    assert min(delays) >= 0.2 and max(delays) <= 1.3 + 1e-9
    assert 0.25 < statistics.median(delays) < 0.28
    assert 0.08 < sum(delay > 1.0 for delay in delays) / len(delays) < 0.12


def test_windows_last_a_second_between_blackouts_of_one_to_thirty() -> None:
    windows = random_windows(5, 1000.0)
    line = Line(DRC_FAST, 0, windows)
    gaps = [start - end for (_, end), (start, _) in zip([(0.0, 0.0), *windows], windows, strict=False)]
    assert all(1.0 <= gap <= 30.0 for gap in gaps) and all(end - start == pytest.approx(1.0) for start, end in windows)
    assert not line.put(100, windows[0][0] - 0.01) and line.put(100, windows[0][0] + 0.5)
    assert not line.put(100, windows[0][1] + 0.01)


def test_darpas_example_begins_with_a_window_and_ends_with_one_that_lasts() -> None:
    windows = drc_windows()
    line = Line(DRC_FAST, 0, windows)
    gaps = [start - end for (_, end), (start, _) in pairwise(windows)]
    assert min(gaps) == 1.0 and max(gaps) == 30.0 and {end - start for start, end in windows[:-1]} == {1.0}
    assert windows[0] == (0.0, 1.0) and windows[-1][0] == 45 * 60 + 37
    assert line.there(0.5) and not line.there(1.5) and line.there(2740.0) and line.there(1e6)


def test_two_ends_on_sockets_speak_through_it_and_a_cut_is_a_cut() -> None:
    robot_secret, operator_secret = secrets_of_both()
    robot = End(Session(robot_secret, True, b"01234567"), ROBOT, 0.0, True)
    operator = End(Session(operator_secret, False, b"01234567"), OPERATOR, 0.0, True)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as a, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as b:
        a.bind(("127.0.0.1", 0))
        b.bind(("127.0.0.1", 0))
        ports = a.getsockname()[1], b.getsockname()[1]
    emulator = Emulator(ports, Conditions(delay=0.01), DRC_FAST, windows=())
    listening = Carrier(robot, own=[("127.0.0.1", port) for port in ports])
    calling = Carrier(operator, other=[("127.0.0.1", emulator.listening + place) for place in (0, 1)])
    now = [0.0]
    arrived: list[Arrived] = []

    def turn() -> bool:
        now[0] += 0.05
        calling.turn(now[0])
        listening.wait(0.02)
        listening.turn(now[0])
        calling.wait(0.02)
        arrived.extend(event for event in robot.events() if isinstance(event, Arrived))
        return robot.session.established and operator.session.established and operator.other.least(now[0]) > 0.0

    try:
        wait_until(turn, 20.0, "a session")
        operator.send(Kind.COMMAND, b"one", now[0])
        wait_until(lambda: turn() and arrived, 20.0, "the command")
        emulator.cut = True
        operator.send(Kind.COMMAND, b"two", now[0])
        wait_until(lambda: turn() and operator.silent(now[0]) > 8.0, 60.0, "silence")
        emulator.cut = False
        wait_until(lambda: turn() and operator.silent(now[0]) < 1.0, 60.0, "to be heard again")
        assert [event.content for event in arrived] == [b"one"]
    finally:
        listening.close()
        calling.close()
        emulator.close()
