"""An attitude from rates and accelerations: aligned at rest, turned by the rate, drawn to where gravity is."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.examples import examples
from valor.common.rotation import Quaternion, Vector, multiply, rotate
from valor.comms_manager.hardware.kvh import ALIGNMENT, GRAVITY, LONGEST_GAP, REST_RATE, TIME_CONSTANT, AttitudeFilter

PERIOD = 0.004
STILL: Vector = (0.0, 0.0, 0.0)
Tilt = st.floats(-1.5, 1.5)


def tilted(roll: float, pitch: float) -> Quaternion:
    half = 0.5 * pitch, 0.5 * roll
    return multiply((math.cos(half[0]), 0.0, math.sin(half[0]), 0.0), (math.cos(half[1]), math.sin(half[1]), 0.0, 0.0))


def up(orientation: Quaternion | None) -> Vector:
    """Where the world's z axis points, in the sensor."""
    assert orientation is not None
    w, x, y, z = orientation
    return rotate((w, -x, -y, -z), (0.0, 0.0, 1.0))


def force(orientation: Quaternion) -> Vector:
    x, y, z = up(orientation)
    return GRAVITY * x, GRAVITY * y, GRAVITY * z


def run(attitude: AttitudeFilter, seconds: float, rate: Vector, specific: Vector) -> None:
    for _ in range(round(seconds / PERIOD)):
        attitude.update(rate, specific, PERIOD)


def aligned(roll: float = 0.0, pitch: float = 0.0) -> AttitudeFilter:
    attitude = AttitudeFilter()
    run(attitude, ALIGNMENT + 2 * PERIOD, STILL, force(tilted(roll, pitch)))
    return attitude


@given(Tilt, Tilt)
@examples(50)
def test_at_rest_it_is_tilted_as_gravity_requires(roll: float, pitch: float) -> None:
    np.testing.assert_allclose(up(aligned(roll, pitch).orientation), up(tilted(roll, pitch)), atol=1e-9)


@given(Tilt, Tilt, st.tuples(*[st.floats(-3.0, 3.0)] * 3))
@examples(30)
def test_it_goes_with_its_rate_and_has_no_doubts_while_gravity_agrees(roll: float, pitch: float, rate: Vector) -> None:
    attitude = aligned(roll, pitch)
    true = attitude.orientation
    assert true is not None
    angle = PERIOD * math.hypot(*rate)
    share = 0.5 * PERIOD if angle < 1e-12 else PERIOD * math.sin(0.5 * angle) / angle
    step: Quaternion = (math.cos(0.5 * angle), share * rate[0], share * rate[1], share * rate[2])
    for _ in range(100):
        attitude.update(rate, force(true), PERIOD)
        true = multiply(true, step)
    assert attitude.orientation is not None and abs(np.dot(true, attitude.orientation)) == pytest.approx(1.0, abs=2e-5)


def test_a_wrong_tilt_goes_back_by_a_factor_of_e_in_its_time() -> None:
    attitude = aligned(roll=0.1)
    run(attitude, TIME_CONSTANT, STILL, (0.0, 0.0, GRAVITY))
    assert math.asin(up(attitude.orientation)[1]) == pytest.approx(0.1 / math.e, rel=0.02)


def test_it_does_not_align_while_it_moves_nor_keeps_what_it_did_not_see() -> None:
    attitude = AttitudeFilter()
    run(attitude, 1.0, (2.0 * REST_RATE, 0.0, 0.0), (0.0, 0.0, GRAVITY))
    run(attitude, 1.0, STILL, (0.0, 0.0, 1.2 * GRAVITY))
    assert attitude.orientation is None
    sway = [0.8 * math.sin(2.0 * math.pi * PERIOD * k) for k in range(500)]  # of a robot that walks [m/s²]
    for across in sway:
        attitude.update(STILL, (0.0, across, GRAVITY), PERIOD)
        assert attitude.orientation is None
    attitude = aligned(roll=0.3)
    attitude.update(STILL, force(tilted(0.3, 0.0)), 1.5 * LONGEST_GAP)
    assert attitude.orientation is not None, "by gravity nothing has happened"
    attitude.update(STILL, (0.0, 0.0, GRAVITY), 1.5 * LONGEST_GAP)
    assert attitude.orientation is None, "it may have been turned meanwhile"
    run(attitude, ALIGNMENT + 2 * PERIOD, STILL, (0.0, 0.0, GRAVITY))
    assert up(attitude.orientation) == pytest.approx((0.0, 0.0, 1.0))
