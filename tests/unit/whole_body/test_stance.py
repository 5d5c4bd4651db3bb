"""The feet's stance to each other is held, wherever both are."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.closed_loop import ClosedLoop, load_robot
from valor.common import rotation
from valor.whole_body.balance.reference import Feet
from valor.whole_body.state import RobotState
from valor.whole_body.tasks.feet import hold, stance

STIFFNESS = 100.0


@pytest.fixture(scope="module")
def standing() -> RobotState:
    """ESCHER's state, standing."""
    loop = ClosedLoop(load_robot())
    loop.run(0.02)
    return loop.state


def soles(state: RobotState) -> tuple[np.ndarray, np.ndarray]:
    """Places (2, 3) and rotations (2, 3, 3)."""
    return state.sole_positions_in_odom, state.sole_rotations_in_odom


def feet(positions: np.ndarray, rotations: np.ndarray) -> Feet:
    return Feet(ca.DM(positions), ca.DM(rotations.reshape(6, 3)))


def moved(state: RobotState, heading: float, place: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Both soles turned about odom's origin and moved."""
    turn = rotation.yaw_matrix(heading)
    positions, rotations = soles(state)
    return positions @ turn.T + (*place, 0.0), turn @ rotations


def wanted(standing: RobotState, now: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """(12,) of the soles, so that they stand to each other as they did."""
    return np.array(hold(feet(*now), stance(feet(*soles(standing))), STIFFNESS))[:, 0]


@given(st.floats(-3.0, 3.0), st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))
def test_where_both_feet_are_together_does_not_matter(standing: RobotState, heading: float, x: float, y: float) -> None:
    np.testing.assert_allclose(wanted(standing, moved(standing, heading, (x, y))), 0.0, atol=1e-9)


@given(st.floats(-3.0, 3.0))
def test_feet_that_crept_apart_are_drawn_together(standing: RobotState, heading: float) -> None:
    """The left foot 2 mm ahead, 1 mm outwards and turned by 3 mrad: each foot makes up for half."""
    positions, rotations = moved(standing, heading, (1.0, 2.0))
    ahead = rotation.yaw_matrix(heading) @ (0.002, 0.001, 0.0)
    positions[0] += ahead
    rotations[0] = rotation.yaw_matrix(0.003) @ rotations[0]
    left, right = np.split(wanted(standing, (positions, rotations)), 2)
    np.testing.assert_allclose(left[:3], -0.5 * STIFFNESS * ahead, atol=1e-9)
    np.testing.assert_allclose(left[3:], (0.0, 0.0, -0.5 * STIFFNESS * 0.003), atol=1e-9)
    np.testing.assert_allclose(right, -left, atol=1e-12)
