"""The feet's stance to each other is held, wherever both are."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motion_manager.whole_body import RobotState, rotation
from motion_manager.whole_body.stance import Stance
from tests.unit.whole_body.closed_loop import ClosedLoop, load_robot

STIFFNESS = 100.0


@pytest.fixture(scope="module")
def standing() -> RobotState:
    """ESCHER's state, standing."""
    loop = ClosedLoop(load_robot())
    loop.run(0.02)
    return loop.state


def moved(state: RobotState, heading: float, place: tuple[float, float]) -> RobotState:
    """The state with both soles turned about odom's origin and moved."""
    turn = rotation.yaw_matrix(heading)
    return dataclasses.replace(
        state,
        sole_positions_in_odom=state.sole_positions_in_odom @ turn.T + (*place, 0.0),
        sole_rotations_in_odom=turn @ state.sole_rotations_in_odom,
    )


@given(st.floats(-3.0, 3.0), st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))
def test_where_both_feet_are_together_does_not_matter(standing: RobotState, heading: float, x: float, y: float) -> None:
    stance, wanted = Stance(STIFFNESS), np.zeros(12)
    stance.reset(standing)
    stance.hold(moved(standing, heading, (x, y)), wanted)
    np.testing.assert_allclose(wanted, 0.0, atol=1e-9)


@given(st.floats(-3.0, 3.0))
def test_feet_that_crept_apart_are_drawn_together(standing: RobotState, heading: float) -> None:
    """The left foot 2 mm ahead, 1 mm outwards and turned by 3 mrad: each foot makes up for half."""
    stance, wanted = Stance(STIFFNESS), np.zeros(12)
    stance.reset(standing)
    crept = moved(standing, heading, (1.0, 2.0))
    ahead = rotation.yaw_matrix(heading) @ (0.002, 0.001, 0.0)
    crept.sole_positions_in_odom[0] += ahead
    crept.sole_rotations_in_odom[0] = rotation.yaw_matrix(0.003) @ crept.sole_rotations_in_odom[0]
    stance.hold(crept, wanted)
    left, right = wanted[:6], wanted[6:]
    np.testing.assert_allclose(left[:3], -0.5 * STIFFNESS * ahead, atol=1e-9)
    np.testing.assert_allclose(left[3:], (0.0, 0.0, -0.5 * STIFFNESS * 0.003), atol=1e-9)
    np.testing.assert_allclose(right, -left, atol=1e-12)
