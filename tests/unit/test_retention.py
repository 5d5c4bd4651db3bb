"""Which recordings go: for any of them, any bounds and any disk."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from valor.bags.retention import RESERVE, Disk, Piece, surplus
from valor.common.bounds import DAY, PIECES, UNBOUNDED, Bounds
from valor.common.table import TableError, checked

NOW = 1_800_000_000.0
GB = 10**9
SIZES = st.integers(0, 8 * GB)
DISKS = st.builds(lambda capacity, part: Disk(capacity, int(capacity * part)), st.integers(GB, 10**13), st.floats(0, 1))
BOUNDS = st.builds(
    Bounds,
    age=st.none() | st.floats(60.0, 100 * DAY),
    size=st.none() | st.integers(8 << 20, 100 * GB),
    share=st.none() | st.floats(0.001, 1.0),
)


@st.composite
def _pieces(draw: st.DrawFn) -> list[Piece]:
    """Of any age, from the future too, and in any order."""
    rows = draw(st.lists(st.tuples(SIZES, st.floats(-DAY, 200 * DAY), st.booleans()), max_size=12))
    return [Piece(Path(f"/bags/{i}.mcap"), size, NOW - age, stays) for i, (size, age, stays) in enumerate(rows)]


def total(pieces: list[Piece]) -> int:
    return sum(piece.size for piece in pieces)


@given(_pieces(), BOUNDS, DISKS, st.none() | SIZES)
def test_what_stays_is_within_bounds_and_nothing_goes_that_need_not(
    pieces: list[Piece], bounds: Bounds, disk: Disk, floor: int | None
) -> None:
    going = [each.piece for each in surplus(pieces, bounds, disk, NOW, floor)]
    left = [piece for piece in pieces if piece not in going]
    could = [piece for piece in left if not piece.stays]
    limit = bounds.limit(disk.capacity)

    assert not any(piece.stays for piece in going)
    assert len(going) == len(set(going)) and set(going) <= set(pieces)
    if could:
        assert max((piece.ended for piece in going), default=0.0) <= min(piece.ended for piece in could)
        assert limit is None or total(left) <= limit
        assert bounds.age is None or min(piece.ended for piece in could) >= NOW - bounds.age
    for last in going[-1:]:
        before = total(left) + last.size
        free = disk.free + total(going) - last.size
        assert (
            (bounds.age is not None and last.ended < NOW - bounds.age)
            or (limit is not None and before > limit)
            or (floor is not None and free < disk.reserve and total(left) >= floor)
        )


@given(_pieces(), BOUNDS, DISKS, st.none() | SIZES)
def test_once_they_are_gone_nothing_more_goes(
    pieces: list[Piece], bounds: Bounds, disk: Disk, floor: int | None
) -> None:
    going = [each.piece for each in surplus(pieces, bounds, disk, NOW, floor)]
    left = [piece for piece in pieces if piece not in going]
    assert surplus(left, bounds, replace(disk, free=disk.free + total(going)), NOW, floor) == []


@given(_pieces(), DISKS, SIZES)
def test_what_others_fill_the_disk_with_costs_nothing_that_was_there_before(
    pieces: list[Piece], disk: Disk, floor: int
) -> None:
    going = [each.piece for each in surplus(pieces, UNBOUNDED, disk, NOW, floor)]
    assert not going or total(pieces) - total(going) >= floor
    if disk.free >= disk.reserve:
        assert not going
    assert surplus(pieces, UNBOUNDED, disk, NOW) == []


@given(BOUNDS, st.integers(GB, 10**13))
def test_what_is_being_written_fits_in_with_the_rest(bounds: Bounds, capacity: int) -> None:
    size, age = bounds.piece(capacity)
    limit = bounds.limit(capacity)
    assert limit is None or size <= max(1 << 20, limit / PIECES)
    assert bounds.age is None or age <= bounds.age / PIECES


def test_each_bound_by_itself() -> None:
    disk = Disk(100 * GB, 50 * GB)
    old, middle, new = (Piece(Path(f"/{age}"), 2 * GB, NOW - age * DAY, False) for age in (9, 5, 1))

    def going(**bounds: float) -> list[Piece]:
        return [each.piece for each in surplus([new, old, middle], checked(Bounds, {
            "age": None, "size": None, "share": None} | bounds), disk, NOW)]  # fmt: skip

    assert going(age=6 * DAY) == [old]
    assert going(size=4 * GB) == [old]
    assert going(size=3 * GB) == [old, middle]
    assert going(share=0.02) == [old, middle]
    assert going(share=0.06) == []


def test_a_full_disk_makes_the_oldest_give_way_until_there_is_room_again() -> None:
    pieces = [Piece(Path(f"/{i}"), RESERVE // 2, NOW - 100 + i, False) for i in range(6)]
    full = Disk(100 * RESERVE, 0)
    assert [each.piece for each in surplus(pieces, UNBOUNDED, full, NOW, floor=0)] == pieces[:2]
    assert [each.piece for each in surplus(pieces, UNBOUNDED, full, NOW, floor=5 * RESERVE // 2)] == pieces[:1]


def test_a_file_of_a_computer_without_a_clock_has_no_age() -> None:
    undated = Piece(Path("/a"), GB, 86400.0, False)
    assert surplus([undated], Bounds(), Disk(10**12, 10**12), NOW) == []
    assert [each.piece for each in surplus([undated], Bounds(size=GB // 2), Disk(10**12, 10**12), NOW)] == [undated]


@pytest.mark.parametrize("wrong", [{"age": 0.0}, {"size": 1000}, {"share": 0.0}, {"share": 1.5}, {"age": float("nan")}])
def test_bounds_that_make_no_sense_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(TableError):
        checked(Bounds, wrong)
