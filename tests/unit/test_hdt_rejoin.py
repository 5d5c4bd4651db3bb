"""How the Comms Manager takes joints back that were out of its reach."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valor.comms_manager.hardware.hdt import SPEED, Rejoining

PERIOD = 0.01
ALL, NONE = np.ones(3, dtype=bool), np.zeros(3, dtype=bool)


def test_the_first_set_point_is_where_the_joints_are_and_the_way_is_slow() -> None:
    joints, found, wanted = Rejoining(3), np.array([0.1, -0.4, 2.0]), np.array([0.1, 0.6, 1.5])
    joints.measured(found, ALL)
    assert joints.advance(found, 0.0) == pytest.approx(found)
    joints.lost()
    joints.measured(found, ALL)
    path = [joints.advance(wanted, PERIOD) for _ in range(300)]
    assert np.abs(path[0] - found).max() <= SPEED * PERIOD + 1e-12
    assert np.abs(np.diff(path, axis=0)).max() <= SPEED * PERIOD + 1e-12
    assert path[-1] == pytest.approx(wanted) and not joints.returning.any()
    assert joints.advance(wanted + 1.0, PERIOD) == pytest.approx(wanted + 1.0), "once there, it follows at once"


@given(
    st.lists(
        st.tuples(st.lists(st.booleans(), min_size=3, max_size=3), st.floats(-1, 1), st.floats(-1, 1)), max_size=40
    )
)
def test_whoever_was_out_begins_where_it_was_found(history: list[tuple[list[bool], float, float]]) -> None:
    joints = Rejoining(3)
    out = ALL.copy()
    for reachable, place, wish in history:
        able, found = np.array(reachable), np.full(3, place)
        before = joints.position.copy()
        joints.measured(found, able)
        told = joints.advance(np.full(3, wish), PERIOD)
        back = out & able
        assert np.abs(told[back] - found[back]).max(initial=0.0) <= SPEED * PERIOD + 1e-12
        assert (told[~able] == before[~able]).all(), "who is out is told nothing new"
        out = ~able
