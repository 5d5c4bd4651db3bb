"""The feet's stance to each other is held, wherever both are."""

import casadi as ca
import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.closed_loop import ClosedLoop, load_robot
from tests.unit.whole_body.conftest import RandomState, random_states
from valor.common import rotation
from valor.control.state import RobotState
from valor.robot.model import Model
from valor.whole_body.balance.reference import Feet
from valor.whole_body.tasks import hold, stance
from valor.whole_body.walking.velocity_steps import FOOTHOLDS, STEEPEST, GroundPlane

STIFFNESS = 100.0


@pytest.fixture(scope="module")
def standing() -> RobotState:
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


# What the footholds report the ground ahead.
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
def test_on_a_plane_the_next_foothold_is_reported_nearly_and_never_overdone(
    rise: float, lean: float, x: float, y: float, height: float
) -> None:
    feet = zigzag(FOOTHOLDS + 2, 0.25, (x, y))
    feet[:, 2] = height + rise * (feet[:, 0] - x) + lean * (feet[:, 1] - y)
    ground = GroundPlane()
    walked(ground, feet[:-1])
    following = feet[-1]
    without = feet[:-1, 2][-1]
    error = ground.height(following[0], following[1]) - following[2]
    assert abs(error) <= 0.6 * (abs(rise) * 0.25 + abs(lean) * 0.2) + 1e-9
    if rise == lean == 0.0:
        assert without == pytest.approx(height)
        assert error == pytest.approx(0.0, abs=1e-9)


def test_a_slope_is_followed_after_three_steps_on_it() -> None:
    feet, ground = zigzag(9, 0.4), GroundPlane()
    feet[5:, 2] = -0.04 * np.arange(1, 5)
    walked(ground, feet[:-1])
    assert ground.height(feet[-1, 0], feet[-1, 1]) == pytest.approx(feet[-1, 2], abs=0.012)


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


# Dynamics, Jacobians, their drift and the centroidal quantities, against MuJoCo's own and finite differences.
STATES = 5


@pytest.fixture(params=range(STATES))
def state(request: pytest.FixtureRequest, model: Model) -> RandomState:
    state: RandomState = list(random_states(model, STATES, seed=1))[request.param]
    return state


def test_mass_matrix_and_bias_do_not_depend_on_place_and_linear_velocity(model: Model, state: RandomState) -> None:
    dynamics = state.evaluate(model)
    full = np.zeros_like(dynamics.mass_matrix)
    mujoco.mj_fullM(model.mj, state.data, full)
    np.testing.assert_allclose(dynamics.mass_matrix, full, atol=1e-10)
    np.testing.assert_allclose(dynamics.bias, state.data.qfrc_bias, atol=1e-9)


def test_angular_momentum_matrix(model: Model, state: RandomState) -> None:
    dynamics = state.evaluate(model)
    matrix = np.zeros((3, model.mj.nv))
    mujoco.mj_angmomMat(model.mj, state.data, matrix, model.body(model.robot.tables.base))
    np.testing.assert_allclose(dynamics.jacobian[dynamics.rows["angular_momentum"]], matrix, atol=1e-11)
