"""Dynamics, Jacobians, their drift and the centroidal quantities, against MuJoCo's own and finite differences."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tests.unit.whole_body.conftest import RandomState, random_states
from valor.common.arrays import FloatArray
from valor.robot.model import Model
from valor.whole_body.model.dynamics import Dynamics
from valor.whole_body.tasks.table import motions

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


def test_com_and_its_jacobian(model: Model, state: RandomState) -> None:
    dynamics = state.evaluate(model)
    base = model.body(model.robot.tables.base)
    jacobian = np.zeros((3, model.mj.nv))
    mujoco.mj_jacSubtreeCom(model.mj, state.data, jacobian, base)
    # MuJoCo's derives from the bodies' masses; ours from the mass matrix, whose armature acts on joints alone.
    np.testing.assert_allclose(dynamics.jacobian[dynamics.rows["com"]], jacobian, atol=1e-12)
    np.testing.assert_allclose(dynamics.com, state.data.subtree_com[base] - state.qpos[:3], atol=1e-12)


def test_angular_momentum_matrix(model: Model, state: RandomState) -> None:
    dynamics = state.evaluate(model)
    matrix = np.zeros((3, model.mj.nv))
    mujoco.mj_angmomMat(model.mj, state.data, matrix, model.body(model.robot.tables.base))
    np.testing.assert_allclose(dynamics.jacobian[dynamics.rows["angular_momentum"]], matrix, atol=1e-11)


def test_sole_and_chest_jacobians(model: Model, state: RandomState) -> None:
    dynamics, tables = state.evaluate(model), model.robot.tables
    nv = model.mj.nv
    for foot, first in ((tables.feet.left, 0), (tables.feet.right, 6)):
        linear, angular = np.zeros((3, nv)), np.zeros((3, nv))
        mujoco.mj_jacSite(model.mj, state.data, linear, angular, model.site(foot.sole))
        np.testing.assert_allclose(
            dynamics.jacobian[dynamics.rows["feet"]][first : first + 6], np.vstack((linear, angular)), atol=1e-12
        )
    angular = np.zeros((3, nv))
    mujoco.mj_jacBody(model.mj, state.data, None, angular, model.body(tables.chest))
    np.testing.assert_allclose(dynamics.jacobian[dynamics.rows["chest"]], angular, atol=1e-12)
    mujoco.mj_jacBody(model.mj, state.data, None, angular, model.body(tables.base))
    np.testing.assert_allclose(dynamics.jacobian[dynamics.rows["pelvis"]], angular, atol=1e-12)


def test_drift_against_mujocos_jacobian_derivative(model: Model, state: RandomState) -> None:
    dynamics, tables = state.evaluate(model), model.robot.tables
    nv = model.mj.nv
    points = [
        (model.site(foot.sole), foot.body, first) for foot, first in ((tables.feet.left, 0), (tables.feet.right, 6))
    ]
    drift = dynamics.drift[dynamics.rows["feet"]]
    for site, body, first in points:
        linear, angular = np.zeros((3, nv)), np.zeros((3, nv))
        mujoco.mj_jacDot(model.mj, state.data, linear, angular, state.data.site_xpos[site], model.body(body))
        np.testing.assert_allclose(drift[first : first + 3], linear @ state.qvel, atol=1e-9)
        np.testing.assert_allclose(drift[first + 3 : first + 6], angular @ state.qvel, atol=1e-9)


def test_all_drifts_against_finite_differences(model: Model, state: RandomState) -> None:
    """d/dt (J·v) at constant v is J̇·v: central differences along the motion itself."""
    step = 1e-5

    def velocity(time: float) -> FloatArray:
        qpos = state.qpos.copy()
        mujoco.mj_integratePos(model.mj, qpos, state.qvel, time)
        moved: Dynamics = RandomState(qpos, state.qvel, state.data).evaluate(model)
        result: FloatArray = moved.jacobian @ state.qvel
        return result

    drift = state.evaluate(model).drift
    numeric = (velocity(step) - velocity(-step)) / (2.0 * step)
    np.testing.assert_allclose(drift, numeric, rtol=1e-5, atol=1e-5)


def test_momentum_rates_obey_newton_and_euler(model: Model, state: RandomState) -> None:
    """Forward dynamics in free fall: the CoM accelerates with gravity, angular momentum about it stays."""
    dynamics = state.evaluate(model)
    acceleration = np.linalg.solve(dynamics.mass_matrix, -dynamics.bias)  # no torques, no contacts
    rates = dynamics.jacobian @ acceleration + dynamics.drift
    np.testing.assert_allclose(rates[dynamics.rows["com"]], (0.0, 0.0, -dynamics.gravity), atol=1e-8)
    np.testing.assert_allclose(rates[dynamics.rows["angular_momentum"]], 0.0, atol=1e-8)


def test_velocities_of_tasks_are_relative_to_the_pelvis_linear_velocity(model: Model, state: RandomState) -> None:
    dynamics = state.evaluate(model)
    linear = motions(model).carried @ state.qvel[:3]
    np.testing.assert_allclose(dynamics.task_velocity + linear, dynamics.jacobian @ state.qvel, atol=1e-10)
    assert dynamics.task_velocity[dynamics.rows["feet"]].shape == (12,)
