"""Gaps between the VRC's cycles in robot time."""

from __future__ import annotations

from valor.valor_ros_controller.cycle_gaps import STRANGE, WINDOW, CycleGaps


def test_what_comes_later_than_expected_is_counted_and_another_robot_time_is_not() -> None:
    gaps = CycleGaps(3)
    for now, periods in enumerate((2, 3, 2, 4, 9, 0, -5, STRANGE)):
        gaps.note(periods, now * 1e-3)
    assert gaps.late == 2 and gaps.longest(0.01) == 9


def test_the_longest_of_the_last_seconds_is_remembered_and_no_longer() -> None:
    gaps = CycleGaps(3)
    gaps.note(50, 10.0)
    gaps.note(2, 10.0 + 1.5 * WINDOW)
    assert gaps.longest(10.0 + 1.5 * WINDOW) == 50, "less than two windows ago"
    gaps.note(4, 10.0 + 2.6 * WINDOW)
    assert gaps.longest(10.0 + 2.6 * WINDOW) == 4
    assert gaps.longest(10.0 + 9.0 * WINDOW) == 0, "nothing has been heard for long"
