"""Bounds on accelerations keep joints off their stops and within their speed."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from harness.closed_loop import load_robot
from harness.examples import examples
from valor.motion_manager.kernel import Kernel
from valor.motion_manager.tuning_tables import Tuning
from valor.motion_manager.whole_body.constraints.joint_limits import JointLimits

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
