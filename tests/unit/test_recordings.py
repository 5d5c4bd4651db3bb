"""The recordings in a folder: what is one, what may go, and what never does."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest
from rosbags.rosbag2 import Reader

from valor.bag_recorder.bag import Bag, RecordedTopic
from valor.bags import recordings, rosbag2_metadata
from valor.common.bounds import UNBOUNDED, Bounds
from valor.common.errors import ConfigurationError

WORDS = RecordedTopic("/words", "std_msgs/msg/String", "string data")
LEAST = Bounds(age=None, size=8 << 20, share=None)
DAY1, DAY2, DAY3 = (f"2026-05-0{day}_10-00-00" for day in (1, 2, 3))


def record(bags: Path, name: str, pieces: int = 1, size: int = 3 << 20) -> list[Path]:
    """A recording as the recorder leaves it; each piece a minute younger than the one before."""
    made = []
    for i in range(pieces):
        path = bags / name / f"{name}{f'_{i}' if i else ''}.mcap"
        path.parent.mkdir(exist_ok=True, parents=True)
        bag = Bag(path)
        bag.write(WORDS, 10**9 * (i + 1), 10**9 * (i + 1), i, os.urandom(size))
        bag.close()
        when = (0.0 if name == "walk" else recordings.begun(name)) + 60.0 * (i + 1)
        os.utime(path, (when, when))
        made.append(path)
    rosbag2_metadata.write(bags / name)
    return made


def names(bags: Path) -> list[str]:
    return sorted(path.name for path in bags.rglob("*.mcap"))


def test_the_oldest_pieces_go_and_what_is_left_reads_as_one_bag(tmp_path: Path) -> None:
    first, second = record(tmp_path, DAY1), record(tmp_path, DAY2, pieces=3)
    gone = recordings.prune(tmp_path, LEAST)
    assert [each.piece.path for each in gone] == [*first, second[0]]
    assert not first[0].parent.exists(), "with its last piece a recording is gone"
    assert names(tmp_path) == sorted(path.name for path in second[1:])
    with Reader(tmp_path / DAY2) as reader:
        assert reader.message_count == 2
    assert recordings.prune(tmp_path, LEAST) == []


def test_what_is_being_written_or_marked_stays(tmp_path: Path) -> None:
    kept = record(tmp_path, DAY1)
    (marked,) = recordings.look(tmp_path)
    recordings.keep(marked, True)
    record(tmp_path, DAY2)
    written = Bag(tmp_path / DAY2 / f"{DAY2}_1.mcap")
    written.write(WORDS, 1, 1, 1, os.urandom(5 << 20))
    written.flush()
    gone = recordings.prune(tmp_path, LEAST)
    assert [each.piece.path.name for each in gone] == [f"{DAY2}.mcap"]
    assert [each.kept for each in recordings.look(tmp_path)] == [True, False]
    assert [each.written for each in recordings.look(tmp_path)] == [False, True]
    written.close()
    recordings.keep(marked, False)
    os.utime(kept[0], (1.6e9, 1.6e9))
    assert [each.piece.path for each in recordings.prune(tmp_path, LEAST)] == kept


def test_what_the_recorder_did_not_write_is_left_alone(tmp_path: Path) -> None:
    bags, elsewhere = tmp_path / "bags", tmp_path / "elsewhere"
    (outside,) = record(elsewhere, DAY1)
    (named,) = record(elsewhere, "walk")
    bags.mkdir()
    named.parent.rename(bags / "walk")
    (bags / DAY1).symlink_to(outside.parent)
    foreign = bags / DAY2 / f"{DAY2}.mcap"
    foreign.parent.mkdir()
    foreign.write_bytes(b"\x89MCAP0\r\n" + bytes(20 << 20))
    (bags / DAY2 / f"{DAY2}_1.mcap").symlink_to(outside)
    (ours,) = record(bags, DAY3, size=9 << 20)
    (ours.parent / "notes.txt").write_text("mine")
    (bags / "notes.mcap").write_bytes(outside.read_bytes())
    before = set(tmp_path.rglob("*"))

    gone = recordings.prune(bags, LEAST)
    assert [each.piece.path for each in gone] == [ours]
    assert before - set(tmp_path.rglob("*")) == {ours, ours.parent / "metadata.yaml"}
    assert outside.exists() and foreign.stat().st_size > 20 << 20


def test_a_bag_that_begins_just_now_is_nobodys_yet(tmp_path: Path) -> None:
    """Between the moments in which a recorder makes a file and locks it."""
    path = tmp_path / DAY1 / f"{DAY1}.mcap"
    path.parent.mkdir()
    path.touch()
    record(tmp_path, DAY2, size=9 << 20)
    recordings.prune(tmp_path, LEAST)
    assert names(tmp_path) == [path.name]


def test_many_who_prune_while_one_records_remove_each_piece_once(tmp_path: Path) -> None:
    record(tmp_path, DAY1, pieces=12, size=1 << 20)
    gone: list[Path] = []
    stop = threading.Event()

    def prune() -> None:
        while not stop.is_set():
            gone.extend(each.piece.path for each in recordings.prune(tmp_path, LEAST))

    threads = [threading.Thread(target=prune) for _ in range(3)]
    for thread in threads:
        thread.start()
    try:
        made = [path for i in range(6) for path in record(tmp_path, f"2026-06-0{i + 1}_10-00-00", size=1 << 20)]
    finally:
        stop.set()
        for thread in threads:
            thread.join()
    recordings.prune(tmp_path, LEAST)
    assert len(gone) == len(set(gone)) >= 10
    assert names(tmp_path) == sorted([f"{DAY1}_11.mcap", *(path.name for path in made)]), "the newest seven"
    for recording in recordings.look(tmp_path):
        with Reader(recording.folder) as reader:
            assert reader.message_count == len(recording.files)


def test_the_bounds_of_the_last_up_are_those_of_prune(tmp_path: Path) -> None:
    assert recordings.saved_bounds(tmp_path) == Bounds()
    for bounds in (LEAST, UNBOUNDED):
        recordings.save_bounds(tmp_path, bounds)
        assert recordings.saved_bounds(tmp_path) == bounds
    (tmp_path / "bounds.json").write_text('{"size": "much"}')
    with pytest.raises(ConfigurationError, match=r"bounds\.json.*size"):
        recordings.saved_bounds(tmp_path)
