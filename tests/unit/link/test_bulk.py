"""Things over the fast channel: whole and proven or not there at all, whatever the channel and the ends do."""

import contextlib
import errno
import os
import random
import shutil
from collections import namedtuple
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.examples import examples
from harness.link_bulk import BulkPair
from valor.link.bulk import sinks
from valor.link.bulk.chunks import Chunks
from valor.link.bulk.errands import Errands
from valor.link.bulk.things import Held, Opened
from valor.link.bulk.wire import CHUNK, Described, checked_name, heard
from valor.link.classes import Bulk
from valor.link.emulator import DRC_FAST, Conditions
from valor.link.errors import BulkError, SealError
from valor.link.schedule import random_windows

BAD = Conditions(
    bandwidth=300e6,
    delay=0.002,
    jitter=0.002,
    loss=0.05,
    duplication=0.05,
    reordering=0.05,
    held=0.05,
    waiting=4_000_000,
)
NAME = "2026-01-01_00-00-00.mcap"
LONG = 300.0  # of simulated time [s]


def filed(folder: Path, size: int, name: str = NAME) -> bytes:
    folder.mkdir(exist_ok=True)
    content = random.Random(size).randbytes(size)
    (folder / name).write_bytes(content)
    return content


def pair(tmp_path: Path, conditions: Conditions = DRC_FAST, **more: object) -> BulkPair:
    (tmp_path / "robot").mkdir(exist_ok=True)
    return BulkPair(tmp_path / "robot", tmp_path / "operator", conditions, **more)  # type: ignore[arg-type]


def here(link: BulkPair, name: str = NAME) -> bool:
    return link.fetcher.errands.all[name].said == "here"


def seen(folder: Path) -> list[str]:
    """What is not hidden."""
    return sorted(each.name for each in folder.iterdir() if not each.name.startswith("."))


def test_twenty_megabytes_arrive_whole_over_several_windows_of_a_bad_channel(tmp_path: Path) -> None:
    content = filed(tmp_path / "robot", 20_000_000)
    windows = [(1.0 + 0.5 * place, 1.1 + 0.5 * place) for place in range(1000)]
    link = pair(tmp_path, BAD, windows=windows)
    link.fetcher.errands.want(NAME)
    while not here(link):
        link.until(lambda: here(link) or not link.fetcher.open, LONG)
        link.until(lambda: here(link) or link.fetcher.open, LONG)
        for name in seen(tmp_path / "operator"):  # under its name it is whole
            assert (tmp_path / "operator" / name).read_bytes() == content
    assert link.now > windows[3][0]
    assert (tmp_path / "operator" / NAME).read_bytes() == content
    assert seen(tmp_path / "operator") == [NAME] and not list((tmp_path / "operator").glob(f".{NAME}*"))


@pytest.mark.parametrize("robot", [True, False])
def test_an_end_that_is_killed_goes_on_where_it_was(tmp_path: Path, robot: bool) -> None:
    content = filed(tmp_path / "robot", 6_000_000)
    windows = [(0.1 + 0.3 * place, 0.2 + 0.3 * place) for place in range(1000)]
    link = pair(tmp_path, windows=windows)
    link.fetcher.errands.want(NAME)
    link.until(lambda: link.fetcher.errands.all[NAME].here > 1_000_000, LONG)
    link.until(lambda: not link.fetcher.open, LONG)
    before = link.fetcher.errands.all[NAME].here
    sent = link.giver.sent
    link.restart(robot)
    taken = link.fetcher.taken
    link.until(lambda: here(link), LONG)
    assert (tmp_path / "operator" / NAME).read_bytes() == content
    rest = -(-(len(content) - before) // CHUNK)
    assert link.fetcher.taken - taken <= rest + 1
    assert robot or link.giver.sent - sent >= rest


def test_the_newest_picture_goes_before_a_bag_that_is_under_way(tmp_path: Path) -> None:
    content = filed(tmp_path / "robot", 5_000_000)
    link = pair(tmp_path, windows=[(0.1, 0.16), (1.0, 100.0)])
    link.fetcher.errands.want(NAME)
    link.until(lambda: link.fetcher.errands.all[NAME].here > 100_000, LONG)
    link.until(lambda: not link.fetcher.open, LONG)
    picture = random.Random(1).randbytes(40_000)
    link.shelf.things = [Held(Bulk.PICTURE, "picture", picture, clock=7, form="jpeg")]
    before = link.fetcher.errands.all[NAME].here
    link.until(lambda: link.fetcher.picture, LONG)
    assert link.fetcher.picture is not None and link.fetcher.picture[1] == picture
    assert link.fetcher.picture[0].clock == 7 and link.fetcher.picture[0].form == "jpeg"
    assert link.fetcher.errands.all[NAME].here - before < 2_000_000
    link.until(lambda: here(link), LONG)
    assert (tmp_path / "operator" / NAME).read_bytes() == content


def test_in_a_blackout_there_are_questions_alone_and_they_are_small(tmp_path: Path) -> None:
    filed(tmp_path / "robot", 5_000_000)
    link = pair(tmp_path, windows=[(0.1, 0.15)])
    link.fetcher.errands.want(NAME)
    link.until(lambda: link.fetcher.errands.all[NAME].here, LONG)
    link.until(lambda: not link.fetcher.open, LONG)
    sent: list[bytes] = []
    for turn in range(500):
        for together in (*link.fetcher.turn(link.now + 0.002 * turn), *link.giver.turn(link.now + 1.0 + 0.002 * turn)):
            sent += together
    assert 40 <= len(sent) <= 60 and max(map(len, sent)) < 160


def test_corrupted_datagrams_are_refused_and_asked_for_again(tmp_path: Path) -> None:
    content = filed(tmp_path / "robot", 400_000)
    chance = random.Random(2)

    def damage(data: bytes) -> bytes:
        place = chance.randrange(len(data))
        return data if chance.random() < 0.8 else data[:place] + bytes((data[place] ^ 1,)) + data[place + 1 :]

    link = pair(tmp_path, damage=damage)
    link.fetcher.errands.want(NAME)
    link.until(lambda: here(link), LONG)
    assert link.refused > 10 and (tmp_path / "operator" / NAME).read_bytes() == content


def test_an_unknown_name_fails_and_the_next_goes_on(tmp_path: Path) -> None:
    content = filed(tmp_path / "robot", 10_000)
    link = pair(tmp_path)
    link.fetcher.errands.want("2020-01-01_00-00-00.mcap")
    link.fetcher.errands.want(NAME)
    link.until(lambda: here(link), LONG)
    assert link.fetcher.errands.all["2020-01-01_00-00-00.mcap"].said.startswith("failed: 2020")
    assert (tmp_path / "operator" / NAME).read_bytes() == content


@pytest.mark.parametrize("name", ["../../etc/passwd", "/etc/passwd", "..", ".hidden", "", "a/b", "a\0b", "a" * 97, "ä"])
def test_names_that_lead_elsewhere_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(SealError, match="expected letters"):
        checked_name(name)
    with pytest.raises(SealError):
        Errands(tmp_path).want(name)
    with pytest.raises((SealError, BulkError)):
        sinks.File(tmp_path / "in", Described(Bulk.BAG, name, 1, bytes(32)))


def test_a_robot_that_describes_what_was_not_asked_for_writes_nothing(tmp_path: Path) -> None:
    filed(tmp_path / "robot", 10_000)
    link = pair(tmp_path)
    other = Opened(tmp_path / "robot" / NAME)
    other.describe(other.digest())
    link.shelf.things = [other]  # type: ignore[list-item]
    link.until(lambda: link.now > 2.0, LONG)
    assert not (tmp_path / "operator").exists()


def test_a_full_disk_is_told_before_anything_is_fetched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    filed(tmp_path / "robot", 10_000)
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage(1 << 40, 1 << 40, 1000))
    link = pair(tmp_path)
    link.fetcher.errands.want(NAME)
    link.until(lambda: link.fetcher.errands.all[NAME].ended, LONG)
    assert "1000 B are free" in link.fetcher.errands.all[NAME].said
    assert seen(tmp_path / "operator") == [] and not list((tmp_path / "operator").glob(f".{NAME}*"))
    monkeypatch.undo()
    link.fetcher.errands.want(NAME)  # room was made
    link.until(lambda: here(link), LONG)


def test_a_disk_that_is_full_on_the_way_ends_this_bag_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    filed(tmp_path / "robot", 200_000)
    second = filed(tmp_path / "robot", 5000, "2026-01-01_00-00-01.mcap")
    link = pair(tmp_path)
    pwritev = os.pwritev

    def full(descriptor: int, content: list[bytes], at: int) -> int:
        if at > 80_000:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return pwritev(descriptor, content, at)

    monkeypatch.setattr(os, "pwritev", full)
    link.fetcher.errands.want(NAME)
    link.fetcher.errands.want("2026-01-01_00-00-01.mcap")
    link.until(lambda: here(link, "2026-01-01_00-00-01.mcap"), LONG)
    assert "No space left" in link.fetcher.errands.all[NAME].said
    assert (tmp_path / "operator" / "2026-01-01_00-00-01.mcap").read_bytes() == second
    assert seen(tmp_path / "operator") == ["2026-01-01_00-00-01.mcap"]


def test_a_file_that_changes_while_it_is_fetched_is_fetched_anew(tmp_path: Path) -> None:
    filed(tmp_path / "robot", 3_000_000)
    link = pair(tmp_path)
    link.fetcher.errands.want(NAME)
    link.until(lambda: link.fetcher.errands.all[NAME].here > 300_000, LONG)
    content = filed(tmp_path / "robot", 2_000_001)
    link.until(lambda: here(link), LONG)
    assert (tmp_path / "operator" / NAME).read_bytes() == content


def test_what_is_on_the_disk_but_is_not_what_was_sent_does_not_appear(tmp_path: Path) -> None:
    content = filed(tmp_path / "robot", 3_000_000)
    link = pair(tmp_path, windows=[(0.1, 0.15), (1.0, 100.0)])
    link.fetcher.errands.want(NAME)
    link.until(lambda: link.fetcher.errands.all[NAME].here > 200_000, LONG)
    link.until(lambda: not link.fetcher.open, LONG)
    with open(tmp_path / "operator" / f".{NAME}.part", "r+b") as part:
        part.write(bytes(1000))
    link.until(lambda: link.fetcher.errands.all[NAME].tries == 1, LONG)
    assert seen(tmp_path / "operator") == []
    link.until(lambda: here(link), LONG)
    assert (tmp_path / "operator" / NAME).read_bytes() == content


def test_datagrams_of_an_old_session_are_refused(tmp_path: Path) -> None:
    filed(tmp_path / "robot", 100)
    link = pair(tmp_path)
    ((old,),) = link.fetcher.turn(link.now)
    link.restart(robot=True)
    with pytest.raises(SealError):
        link.giver.receive(old, link.now)


@given(st.binary(max_size=200))
def test_bytes_of_anybody_are_a_word_or_refused(data: bytes) -> None:
    with contextlib.suppress(SealError):
        heard(data)


@examples(200)
@given(size=st.integers(0, 60 * CHUNK), seed=st.integers(0, 10**6))
def test_every_chunk_is_asked_for_until_it_is_here_and_none_twice_at_once(size: int, seed: int) -> None:
    chance, chunks, now = random.Random(seed), Chunks(size), 0.0
    under_way: set[int] = set()
    got: set[int] = set()
    while not chunks.whole:
        now += 1.0
        asked = [place for first, count in chunks.ask(chance.randint(1, 20), chance.randint(1, 4), now)
                 for place in range(first, first + count)]  # fmt: skip
        assert not set(asked) & (under_way | got) and len(asked) == len(set(asked))
        under_way |= set(asked)
        for place in chance.sample(sorted(under_way), chance.randint(0, len(under_way))):
            assert (chunks.arrived(place) is not None) == (place not in got)
            got.add(place)
            under_way.discard(place)
        if chance.random() < 0.3:
            assert chunks.expire(now + 1.0) == len(under_way)
            under_way.clear()
        assert (chunks.here, chunks.under_way) == (len(got), len(under_way))
        assert chunks.bytes_here == sum(chunks.length(place) for place in got)
        again = Chunks(size)
        again.restore(chunks.kept())
        assert again.here == len(got) and all(again.arrived(place) is None for place in got)
    assert sum(chunks.length(place) for place in range(chunks.count)) == size
    assert chunks.arrived(chunks.count) is None


@given(st.binary(max_size=50))
def test_notes_that_nobody_made_are_as_none(noted: bytes) -> None:
    chunks = Chunks(10 * CHUNK)
    chunks.restore(noted)
    assert 0 <= chunks.here <= 10


def test_windows_at_random_are_found_out(tmp_path: Path) -> None:
    content = filed(tmp_path / "robot", 300_000)
    link = pair(tmp_path, windows=random_windows(4, 200.0))
    link.fetcher.errands.want(NAME)
    link.until(lambda: here(link), LONG)
    assert (tmp_path / "operator" / NAME).read_bytes() == content
