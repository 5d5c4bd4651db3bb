"""What the footholds tell of the ground ahead."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valor.whole_body.walking.ground import FOOTHOLDS, STEEPEST, GroundPlane

slopes = st.floats(-STEEPEST, STEEPEST)
places = st.floats(-50.0, 50.0)


def walked(ground: GroundPlane, places: np.ndarray) -> None:
    """Tell it of (n, 3) footholds, one after the other, the first two those of a robot that stands."""
    for i in range(1, len(places)):
        ground.stand((places[i - 1], places[i]), moved=i > 1)


def zigzag(count: int, stride: float, at: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """(count, 3) level footholds, left and right, from somewhere."""
    i = np.arange(count)
    return np.stack((at[0] + stride * i, at[1] + 0.1 * (-1.0) ** i, np.zeros(count)), axis=1)


@given(slopes, slopes, places, places, st.floats(-3.0, 3.0))
def test_on_a_plane_the_next_foothold_is_told_nearly_and_never_overdone(
    rise: float, lean: float, x: float, y: float, height: float
) -> None:
    feet = zigzag(FOOTHOLDS + 2, 0.25, (x, y))
    feet[:, 2] = height + rise * (feet[:, 0] - x) + lean * (feet[:, 1] - y)
    ground = GroundPlane()
    walked(ground, feet[:-1])
    following = feet[-1]
    without = feet[:-1, 2][-1]
    error = ground.height(following[0], following[1]) - following[2]
    assert abs(error) <= 0.5 * (abs(rise) * 0.25 + abs(lean) * 0.2) + 1e-9
    if rise == lean == 0.0:
        assert without == pytest.approx(height)
        assert error == pytest.approx(0.0, abs=1e-9)


def test_level_ground_is_level_whatever_happened_before_it_was_forgotten() -> None:
    ground = GroundPlane()
    feet = zigzag(8, 0.25)
    walked(ground, feet + np.outer(np.arange(8), (0.0, 0.0, 0.02)))
    assert ground.height(10.0, 0.0) > 0.3
    ground.forget()
    ground.stand((feet[0], feet[1]), moved=False)
    assert ground.height(10.0, 3.0) == pytest.approx(0.0)


def test_a_cliff_is_not_taken_for_a_slope_to_go_on() -> None:
    ground = GroundPlane()
    feet = zigzag(4, 0.25)
    feet[2:, 2] = -1.0
    walked(ground, feet)
    (x, y, z), way = feet[-1], 0.25
    assert z - 1.0 < ground.height(x + way, y) < z + 1.0
    assert ground.height(x + way, y) - ground.height(x, y) >= -STEEPEST * way - 1e-9


def test_a_foot_that_settles_is_believed_where_it_settled() -> None:
    ground, other = GroundPlane(), GroundPlane()
    feet = zigzag(3, 0.25)
    other.stand((feet[0], feet[1]), moved=False)
    other.stand((feet[1], feet[2]), moved=True)
    ground.stand((feet[0], feet[1] + (0.0, 0.0, 0.02)), moved=False)  # on its edge yet
    ground.stand((feet[1], feet[2]), moved=True)
    assert ground.height(1.0, 0.0) == pytest.approx(other.height(1.0, 0.0))
