"""Retention for any recordings, bounds and disk."""

import json
import os
import threading
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.rosbag2 import Reader
from typer.testing import CliRunner

from harness.places import ROBOTS
from valor.bag_recorder.bag import Bag, RecordedTopic
from valor.bags import recordings, retention, rosbag2_metadata
from valor.bags.recordings import Piece
from valor.bags.retention import RESERVE, Disk, surplus
from valor.common.instance import DAY, PIECES, UNBOUNDED, Bounds, Instance, Recording, Settings
from valor.valorctl.instance.checks import CHECKS
from valor.valorctl.recordings import recording_report
from valor.valorctl.terminal.app import app

NOW = 1_800_000_000.0
GB = 10**9
SIZES = st.integers(0, 8 * GB)
DISKS = st.builds(lambda capacity, part: Disk(capacity, int(capacity * part)), st.integers(GB, 10**13), st.floats(0, 1))
BOUNDS = st.builds(
    Bounds, age=st.none() | st.floats(60.0, 100 * DAY), size=st.none() | st.integers(8 << 20, 100 * GB),
    share=st.none() | st.floats(0.001, 1.0),
)  # fmt: skip


@st.composite
def _pieces(draw: st.DrawFn) -> list[Piece]:
    """Of any age, from the future too, and in any order."""
    rows = draw(st.lists(st.tuples(SIZES, st.floats(-DAY, 200 * DAY)), max_size=12))
    return [Piece(Path(f"/bags/{i}.mcap"), size, NOW - age) for i, (size, age) in enumerate(rows)]


def total(pieces: list[Piece]) -> int:
    return sum(piece.size for piece in pieces)


def going(pieces: list[Piece], bounds: Bounds, disk: Disk, floor: int | None = None, staying: int = 0) -> list[Piece]:
    """Pieces to remove; ``staying``: size of those that must stay [B]."""
    return [each.piece for each in surplus(pieces, total(pieces) + staying, bounds, disk, now=NOW, floor=floor)]


@given(_pieces(), BOUNDS, DISKS, st.none() | SIZES, SIZES)
def test_the_rest_is_within_bounds_and_no_piece_is_removed_needlessly(
    pieces: list[Piece], bounds: Bounds, disk: Disk, floor: int | None, staying: int
) -> None:
    gone = going(pieces, bounds, disk, floor, staying)
    left = [piece for piece in pieces if piece not in gone]
    limit = bounds.limit(disk.capacity)
    assert len(gone) == len(set(gone)) and set(gone) <= set(pieces)
    if left:
        assert limit is None or total(left) + staying <= limit
        assert bounds.age is None or min(piece.ended for piece in left) >= NOW - bounds.age
    for last in gone[-1:]:
        before = total(left) + staying + last.size
        free = disk.free + total(gone) - last.size
        assert (
            (bounds.age is not None and last.ended < NOW - bounds.age)
            or (limit is not None and before > limit)
            or (floor is not None and free < disk.reserve and before - last.size >= floor)
        )
    more_free = replace(disk, free=disk.free + total(gone))
    assert going(left, bounds, more_free, floor, staying) == [], "a second call removes nothing"


@given(_pieces(), DISKS, SIZES)
def test_other_programs_data_costs_no_earlier_recording(pieces: list[Piece], disk: Disk, floor: int) -> None:
    gone = going(pieces, UNBOUNDED, disk, floor)
    assert not gone or total(pieces) - total(gone) >= floor
    if disk.free >= disk.reserve:
        assert not gone
    assert going(pieces, UNBOUNDED, disk) == []


@given(BOUNDS, st.integers(GB, 10**13))
def test_a_piece_fits_into_the_bounds(bounds: Bounds, capacity: int) -> None:
    size, age = bounds.piece(capacity)
    limit = bounds.limit(capacity)
    assert limit is None or size <= max(1 << 20, limit / PIECES)
    assert bounds.age is None or age <= bounds.age / PIECES


def test_on_a_full_disk_the_oldest_are_removed() -> None:
    pieces = [Piece(Path(f"/{i}"), RESERVE // 2, NOW - 100 + i) for i in range(6)]
    full = Disk(100 * RESERVE, 0)
    assert going(pieces, UNBOUNDED, full, 0) == pieces[:2]
    assert going(pieces, UNBOUNDED, full, 5 * RESERVE // 2) == pieces[:1]


def test_a_file_dated_before_2020_has_no_age() -> None:
    undated = Piece(Path("/a"), GB, 86400.0)
    assert going([undated], Bounds(), Disk(10**12, 10**12)) == []
    assert going([undated], Bounds(size=GB // 2), Disk(10**12, 10**12)) == [undated]


# Recordings in a folder: listing, pruning, and files that are never removed.
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


def test_the_oldest_pieces_are_removed_and_the_rest_is_one_bag(tmp_path: Path) -> None:
    first, second = record(tmp_path, DAY1), record(tmp_path, DAY2, pieces=3)
    gone = retention.prune(tmp_path, LEAST)
    assert [each.piece.path for each in gone] == [*first, second[0]]
    assert not first[0].parent.exists(), "with its last piece a recording is gone"
    assert names(tmp_path) == sorted(path.name for path in second[1:])
    with Reader(tmp_path / DAY2) as reader:
        assert reader.message_count == 2
    assert retention.prune(tmp_path, LEAST) == []


def test_written_and_marked_recordings_stay(tmp_path: Path) -> None:
    kept = record(tmp_path, DAY1)
    (marked,) = recordings.look(tmp_path)
    recordings.keep(marked, True)
    record(tmp_path, DAY2)
    written = Bag(tmp_path / DAY2 / f"{DAY2}_1.mcap")
    written.write(WORDS, 1, 1, 1, os.urandom(5 << 20))
    written.flush()
    gone = retention.prune(tmp_path, LEAST)
    assert [each.piece.path.name for each in gone] == [f"{DAY2}.mcap"]
    assert [each.kept for each in recordings.look(tmp_path)] == [True, False]
    assert [each.written for each in recordings.look(tmp_path)] == [False, True]
    written.close()
    recordings.keep(marked, False)
    os.utime(kept[0], (1.6e9, 1.6e9))
    assert [each.piece.path for each in retention.prune(tmp_path, LEAST)] == kept


def test_files_of_other_programs_stay(tmp_path: Path) -> None:
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
    (bags / DAY2 / f"{DAY2}_2.mcap").touch()  # as between making and locking it
    (ours,) = record(bags, DAY3, size=9 << 20)
    (ours.parent / "notes.txt").write_text("mine")
    (bags / "notes.mcap").write_bytes(outside.read_bytes())
    before = set(tmp_path.rglob("*"))

    gone = retention.prune(bags, LEAST)
    assert [each.piece.path for each in gone] == [ours]
    assert before - set(tmp_path.rglob("*")) == {ours, ours.parent / "metadata.yaml"}
    assert outside.exists() and foreign.stat().st_size > 20 << 20


def test_concurrent_pruning_removes_each_piece_once(tmp_path: Path) -> None:
    record(tmp_path, DAY1, pieces=12, size=1 << 20)
    gone: list[Path] = []
    stop = threading.Event()

    def prune() -> None:
        while not stop.is_set():
            gone.extend(each.piece.path for each in retention.prune(tmp_path, LEAST))

    threads = [threading.Thread(target=prune) for _ in range(3)]
    for thread in threads:
        thread.start()
    try:
        made = [path for i in range(6) for path in record(tmp_path, f"2026-06-0{i + 1}_10-00-00", size=1 << 20)]
    finally:
        stop.set()
        for thread in threads:
            thread.join()
    retention.prune(tmp_path, LEAST)
    assert len(gone) == len(set(gone)) >= 10
    assert names(tmp_path) == sorted([f"{DAY1}_11.mcap", *(path.name for path in made)]), "the newest seven"
    for recording in recordings.look(tmp_path):
        with Reader(recording.folder) as reader:
            assert reader.message_count == len(recording.files)


# ``bag list``, ``keep``, ``prune`` and ``info``, and reports about recordings.
@pytest.fixture
def instance(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Instance:
    monkeypatch.setenv("VALOR_HOME", str(tmp_path))
    monkeypatch.delenv("VALOR_INSTANCE", raising=False)
    monkeypatch.delenv("VALOR_BAG_BOUND", raising=False)
    made = Instance("default", tmp_path)
    made.bags.mkdir(parents=True)
    return made


def ctl(*arguments: str) -> str:
    result = CliRunner().invoke(app, ["bag", *arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def up(instance: Instance, **changes: object) -> Settings:
    """What `up` leaves behind, as far as these functions look at it."""
    settings = msgspec.structs.replace(Settings(robot=ROBOTS / "escher", ros_domain_id=1), **changes)
    instance.settings_file.write_text(settings.json())
    return settings


def test_recordings_are_listed_kept_and_pruned(instance: Instance) -> None:
    record(instance.bags, DAY1, pieces=2)
    record(instance.bags, DAY2 + "_fall")
    record(Instance("other", instance.folder.parent).bags, DAY3)
    listed = json.loads(ctl("list", "--json"))
    assert [(row["name"], row["kept"], row["written"]) for row in listed] == [
        (DAY1, False, False), (DAY2 + "_fall", False, False)
    ]  # fmt: skip
    assert listed[0]["size"] > 6 << 20 and listed[0]["duration"] == 1.0 and listed[0]["instance"] == "default"
    assert {row["name"] for row in json.loads(ctl("list", "--all", "--json"))} == {DAY1, DAY2 + "_fall", DAY3}

    assert "is kept" in ctl("keep", DAY1) and "kept" in ctl("list")
    ctl("keep", DAY1, "--undo")
    assert "kept" not in ctl("list") and ctl("keep", str(instance.bags / DAY1 / "any piece")) == f"{DAY1} is kept\n"
    bounds = ("--bag-bound", "9MB", "--bag-bound", "9999d")
    reported = ctl("prune", "--dry-run", *bounds)
    assert f"{DAY2}_fall.mcap: 3.1 MB, more than 9 MB in all" in reported and "3.1 MB would be freed" in reported
    assert len(json.loads(ctl("list", "--json"))) == 2
    assert "3.1 MB freed; recordings take 6.3 MB" in ctl("prune", *bounds)
    ctl("keep", str(instance.bags / DAY1), "--undo")
    retention.save_bounds(instance.bags, Bounds(age=None, size=8 << 20, share=None))
    assert "0.0 MB freed" in ctl("prune"), "within those of the last `up`"
    assert "6.3 MB freed; recordings take 0.0 MB" in ctl("prune", "--bag-bound", "60s")
    assert ctl("list").strip() == "no recordings"


def test_info_and_down_report_all_pieces_of_a_recording(instance: Instance, tmp_path: Path) -> None:
    (first, _) = record(instance.bags, DAY1, pieces=2)
    assert recording_report.summary(first).startswith(f"recorded {first.parent}: 6.3 MB, ")
    bag = Bag(tmp_path / "mine.mcap")
    bag.close()
    assert recording_report.summary(bag.path) == f"recorded {bag.path}: 0.0 MB, 0 s"
    shown = ctl("info", DAY1)
    assert "1.0 s, 6.3 MB, 2 messages" in shown and "/words" in shown
    assert json.loads(ctl("info", str(instance.bags / DAY1), "--json"))["messages"] == 2


def test_the_report_states_recording_and_outlook(instance: Instance) -> None:
    settings = up(instance)
    record(instance.bags, DAY1)
    bounds = Bounds(size=20_000_000, share=None)
    ahead = recording_report.outlook(instance, bounds, None)
    taken = recordings.look(instance.bags)[0].size
    assert ahead.seconds == pytest.approx((20e6 - taken) / recording_report.USUAL_RATE) and not ahead.short
    assert ahead.line() == "1.0 MB/s, in 17 s recordings take 20.0 MB and the oldest is removed"
    ahead = recording_report.outlook(instance, UNBOUNDED, None)
    assert ahead.short and 0 < ahead.seconds < ahead.free / recording_report.USUAL_RATE
    ahead = recording_report.outlook(instance, bounds, instance.folder.parent / "mine.mcap")
    assert ahead.limit is None and ahead.line().endswith("the disk is full")
    assert (
        recording_report.glance(instance, bounds).line()
        == "nothing is being written; recordings take 3.1 MB of 20.0 MB"
    )
    assert "status" in recording_report.announcement(instance, settings, ["bag_recorder"])
    assert recording_report.announcement(instance, settings, ["bifrostd"]) == "nothing is recorded"
    ring = up(instance, recording=Recording(ring_seconds=30.0))
    assert "holding the last 30 s" in recording_report.announcement(instance, ring, ["bag_recorder"])


def test_doctor_warns_before_the_disk_is_full(instance: Instance) -> None:
    check = CHECKS["disk"]
    free = retention.disk_of(instance.bags).free
    levels = {}
    for size in (10 << 20, 2 * free):
        retention.save_bounds(instance.bags, Bounds(age=None, size=size, share=None))
        levels[size], text, *advice = check(instance)
    assert levels == {10 << 20: "ok" if free > 3 << 30 else "warn", 2 * free: "warn"}
    assert "are free and the oldest is removed" in text and f"{2 * free / 1e9:.1f} GB" in advice[0]
    (instance.bags / "bounds.json").write_text("{")
    assert check(instance)[0] == "fail"
