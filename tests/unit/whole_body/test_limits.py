"""Bounds on accelerations keep joints off their stops and within their speed."""

from __future__ import annotations

import casadi as ca
import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.closed_loop import load_robot
from harness.examples import examples
from tests.unit.whole_body.conftest import random_states
from valor.common.kernel import Kernel
from valor.robot.model import Model
from valor.whole_body.constraints.joint_limits import JointLimits
from valor.whole_body.constraints.limit import JointLimit, Solved
from valor.whole_body.constraints.torque_limits import TorqueLimits
from valor.whole_body.tuning_tables import Tuning

ROBOT = load_robot()
LIMITS = JointLimits(ROBOT, ROBOT.read(Tuning).whole_body, slice(0, 27))
POSITION, VELOCITY, LOWEST, HIGHEST = np.zeros((4, 27))
KERNEL = Kernel("limits", LIMITS.acceleration, (POSITION, VELOCITY), (LOWEST, HIGHEST))
LOWER, UPPER = ROBOT.lower[:27], ROBOT.upper[:27]
SPEED = ROBOT.velocity_limit[:27]
DT = ROBOT.control_period


def bounds(position: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(27,) lowest and highest accelerations."""
    POSITION[:], VELOCITY[:] = position, velocity
    KERNEL()
    return LOWEST.copy(), HIGHEST.copy()


@given(st.floats(-0.5, 1.5), st.floats(-3.0, 3.0))
def test_bounds_never_cross(share: float, speed: float) -> None:
    """Also beyond the stops and above the speed limit."""
    position = LOWER + share * (UPPER - LOWER)
    lower, upper = bounds(position, speed * SPEED)
    assert (lower <= upper).all()


@examples(15)
@given(st.floats(0.0, 1.0), st.sampled_from((-1.0, 1.0)))
def test_a_joint_driven_as_hard_as_allowed_stays_within_its_limits(share: float, direction: float) -> None:
    position, velocity = LOWER + share * (UPPER - LOWER), np.zeros(27)
    for _ in range(1000):
        lower, upper = bounds(position, velocity)
        velocity = velocity + np.clip(direction * 1e3, lower, upper) * DT
        position = position + velocity * DT
        assert (np.abs(velocity) <= SPEED * 1.001).all()
    assert (position >= LOWER - 1e-3).all()
    assert (position <= UPPER + 1e-3).all()


def test_far_from_stops_nothing_but_the_speed_limit_binds() -> None:
    _, upper = bounds(0.5 * (LOWER + UPPER), np.zeros(27))
    assert (upper > 5.0).all()


@pytest.mark.parametrize("kind", ["torque", "acceleration"])
def test_rows_are_the_derivatives_of_values(model: Model, kind: str) -> None:
    """y = c·v̇ + e − s·ρ by differences in v̇ and ρ, and torques as MuJoCo's inverse dynamics has them."""
    state = next(iter(random_states(model, 1, seed=17)))
    dynamics, n = state.evaluate(model), model.mj.nv - 6
    damping = model.mj.dof_damping[6:].copy()
    limits: JointLimit = TorqueLimits(damping) if kind == "torque" else LIMITS
    rng = np.random.default_rng(4)
    acceleration, pushes, forces = rng.normal(size=n + 6), rng.random(32), rng.normal(size=(32, n + 6))

    def value(acceleration: np.ndarray, pushes: np.ndarray) -> np.ndarray:
        inertial = (dynamics.mass_matrix @ acceleration)[6:]
        columns = inertial, dynamics.bias[6:], (pushes @ forces)[6:], dynamics.joint_velocity, acceleration[6:]
        return np.array(ca.DM(limits.value(Solved(*map(ca.DM, columns)))))[:, 0]

    joints = np.array((0, 3, n - 1))
    rows, offset, effect = limits.rows(dynamics, forces, joints)
    now = value(acceleration, pushes)[joints]
    np.testing.assert_allclose(rows @ acceleration + offset - effect @ pushes, now, rtol=1e-9, atol=1e-9)
    for column, place in ((rows, 0), (-effect, 1)):
        for i in range(column.shape[1]):
            step = [np.zeros(n + 6), np.zeros(32)]
            step[place][i] = 1.0
            moved = value(acceleration + step[0], pushes + step[1])[joints]
            np.testing.assert_allclose(moved - now, column[:, i], atol=1e-9)
    if kind == "torque":
        data = state.data
        data.qacc[:] = acceleration
        inverse = np.zeros(n + 6)
        mujoco.mj_rne(model.mj, data, 1, inverse)
        inverse += model.mj.dof_armature * acceleration
        expected = inverse[6:] + damping * dynamics.joint_velocity - (pushes @ forces)[6:]
        np.testing.assert_allclose(value(acceleration, pushes), expected, atol=1e-8)
