"""A recording on the page: what is kept of a bag, and what is shown where."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from harness.station_bag import BEGIN, JOINT, LENGTH, MODES, RATE, written
from valor.bags.errors import BagError
from valor.operator_station.intake import Intake
from valor.operator_station.player import Player, wanted_of
from valor.operator_station.tape import SPACING, Tape

MS = 1_000_000


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("bag"))


@pytest.fixture
def player(bag: Path) -> Iterator[Player]:
    yield from playing(bag)


def playing(bag: Path) -> Iterator[Player]:
    intake = Intake()
    tape = Tape(bag, wanted_of(intake))
    until(lambda: tape.whole, "it is read")
    yield Player(tape, intake)
    tape.close()


def until(what: Callable[[], bool], name: str) -> None:
    deadline = time.monotonic() + 60.0
    while not what():
        assert time.monotonic() < deadline, name
        time.sleep(0.005)


def shown(player: Player) -> tuple[float, str]:
    """The knee, and the control mode."""
    return player.intake.heard.joints[JOINT], player.intake.heard.mode.current


def test_it_plays_at_its_speed_and_stands_at_its_end(player: Player) -> None:
    player.speed = 2.0
    player.advance(0.75)
    assert player.seconds == pytest.approx(1.5)
    knee, mode = shown(player)
    assert knee == pytest.approx(1.5, abs=SPACING * 1e-9 + 0.005)
    assert mode == "stand"
    player.advance(60.0)
    assert player.seconds == pytest.approx(LENGTH)
    assert not player.playing
    before = shown(player)
    player.advance(1.0)
    assert shown(player) == before


def test_what_the_recorder_noted_is_known_and_where_it_is(player: Player) -> None:
    (mark,) = player._tape.events
    assert (mark.text, player.place(mark.stamp)) == ("mark: the knee is seen", pytest.approx(2.5))


def test_wherever_one_goes_it_is_as_if_one_had_played_to_there(player: Player) -> None:
    for place in (3.5, 0.5, 2.9, 3.1):
        player.seek(place)
        knee, mode = shown(player)
        assert knee == pytest.approx(place, abs=0.03)
        assert mode == [name for when, name in MODES.items() if when <= place][-1]
        bands = player.intake.heard.modes.bands(BEGIN * 1e-9, player.wall)
        assert [name for _, _, name in bands] == [name for when, name in MODES.items() if when <= place]
    player.seek(1e9)
    assert player.seconds == pytest.approx(LENGTH)
    player.step(-1.0)
    assert shown(player)[0] == pytest.approx(LENGTH - 1.0, abs=0.03)


def test_while_it_stands_nothing_grows_old(player: Player) -> None:
    player.seek(2.0)
    ages = player.intake.heard.ages
    age = ages.age("joints", player.wall)
    assert age < 0.1
    player.playing = False
    player.advance(10.0)
    assert ages.age("joints", player.wall) == age


def test_the_past_is_sampled_where_somebody_wants_it(player: Player) -> None:
    sampled: list[float] = []
    player.sampled = lambda now, wall: sampled.append(wall - BEGIN * 1e-9)
    player.past = lambda: 2.0
    player.seek(3.0)
    assert sampled[0] == pytest.approx(1.0, abs=0.1)
    assert sampled[-1] == pytest.approx(3.0)
    assert max(np.diff(sampled)) < 0.1


def test_streams_are_thinned_out_and_what_is_told_is_not(bag: Path) -> None:
    intake = Intake()
    tape = Tape(bag, wanted_of(intake))
    until(lambda: tape.whole, "it is read")
    kept = [intake.inputs[number].topic for _, number, _ in tape.between(0, 2 * BEGIN)]
    tape.close()
    assert kept.count("flor/controller/mode") == len(MODES)
    stride = -(-SPACING // (4 * MS))  # messages
    assert kept.count("joint_states") == pytest.approx(LENGTH * RATE / stride, abs=2)


def test_a_robot_in_a_namespace_is_shown(tmp_path: Path) -> None:
    for player in playing(written(tmp_path, "/lab/escher1")):
        player.seek(1.2)
        assert shown(player) == (pytest.approx(1.2, abs=0.03), "stand")


def test_what_is_cut_off_is_played_as_far_as_it_goes(bag: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(bag.read_bytes()[: bag.stat().st_size // 2])
    intake = Intake()
    tape = Tape(cut, wanted_of(intake))
    until(lambda: tape.whole, "it is read")
    assert any("cut.mcap" in line for line in tape.damage)
    tape.close()
    with pytest.raises(BagError, match=r"nothing\.mcap"):
        Tape(tmp_path / "nothing.mcap", wanted_of(intake))
