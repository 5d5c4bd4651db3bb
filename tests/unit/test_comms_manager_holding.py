"""What devices receive when Motor times out: nothing that would move a joint."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from harness.examples import examples
from valor.common.messages import JointMode, Motor
from valor.comms_manager.hardware.backend import holding

N = 4
SERVO, SPRING = 1, 2  # a joint in each of the two ways
numbers = st.lists(st.floats(-50.0, 50.0), min_size=N, max_size=N).map(np.array)


def last(position: np.ndarray, effort: np.ndarray) -> Motor:
    """A joint is off, one on its own servo, one by impedance, one by force alone; all of them move."""
    mode = np.array([JointMode.OFF, JointMode.POSITION, JointMode.IMPEDANCE, JointMode.FORCE], dtype=np.uint8)
    ones = np.ones(N)
    return Motor(7, 8, 9, mode, position, ones, effort, 100.0 * ones, ones, behavior="stand", writer=3)


@examples(50)
@given(wanted=numbers, measured=numbers, asked=numbers, felt=numbers)
def test_servos_continue_as_they_were_and_the_others_hold_what_they_carry_where_they_are(
    wanted: np.ndarray, measured: np.ndarray, asked: np.ndarray, felt: np.ndarray
) -> None:
    motor = last(wanted, asked)
    held = holding(motor, measured, felt)
    assert (held.mode == JointMode.POSITION).all()
    assert not (held.velocity.any() or held.stiffness.any() or held.damping.any())
    assert held.position[SERVO] == wanted[SERVO] and held.effort[SERVO] == asked[SERVO]
    others = np.arange(N) != SERVO
    assert (held.position[others] == measured[others]).all() and (held.effort[others] == felt[others]).all()
    assert (held.sequence, held.behavior) == (motor.sequence, motor.behavior)
    kept = held.position.copy(), held.effort.copy()
    for changed in (measured, felt):
        np.add(changed, 1.0, out=changed)
    assert (held.position == kept[0]).all() and (held.effort == kept[1]).all(), "measurements are copied"
    assert not holding(last(np.zeros(N), np.zeros(N)), measured, np.full(N, np.nan)).effort.any()
