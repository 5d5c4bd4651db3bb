"""The DCM law and the reference of standing, against numerical integration of the motions they promise."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valor.common.kernel import Expression, Kernel
from valor.control.kinematics import natural_frequency
from valor.whole_body.balance.reference import DcmLaw, followed, minimum_jerk

OMEGA = natural_frequency(0.86, 9.81)
STEP = 5e-4  # of the integration [s]


class Law:
    def __init__(self, law: DcmLaw) -> None:
        self._point, self._com, self._dt = np.zeros((3, 3)), np.zeros(3), np.zeros(1)
        self.omega, self.integral = law.omega, np.zeros(3)
        self._next, self._given, self._acceleration = np.zeros(3), np.zeros(3), np.zeros(3)

        def period(points: Expression, com: Expression, dt: Expression, integral: Expression) -> tuple[Expression, ...]:
            point, integral = law.repellent_point(points[0, :].T, points[1, :].T, points[2, :].T, integral, dt)
            return point, integral, law.acceleration(com, point)

        self._evaluate = Kernel(
            "law", period, (self._point, self._com, self._dt, self.integral),
            (self._given, self._next, self._acceleration),
        )  # fmt: skip

    def acceleration(self, com: np.ndarray, dcm: np.ndarray, reference: np.ndarray, dt: float) -> np.ndarray:
        """Of the CoM, its DCM to be at a reference that rests."""
        self._point[:], self._com[:], self._dt[0] = (dcm, reference, reference), com, dt
        self._evaluate()
        self.integral[:] = self._next
        return self._acceleration.copy()


GRIPS = tuple(Law(DcmLaw(OMEGA, 5.0, 0.0, 0.0, 1.0, 15.0, 0.02, *grip)) for grip in ((), (4.0,)))


def simulate(law: Law, com: np.ndarray, velocity: np.ndarray, duration: float, disturbance: np.ndarray) -> list[float]:
    """Errors of the DCM over time, the CoM driven by the law towards the origin and by a constant acceleration."""
    errors = []
    reference = np.zeros(3)
    for _ in range(round(duration / STEP)):
        dcm = com + velocity / law.omega
        errors.append(float(dcm[0]))
        velocity = velocity + (law.acceleration(com, dcm, reference, STEP) + disturbance) * STEP
        com = com + velocity * STEP
    return errors


@pytest.mark.parametrize("gain", [2.0, 5.0, 12.0])
def test_the_error_decays_with_the_gain(gain: float) -> None:
    law = Law(DcmLaw(OMEGA, gain, integral_gain=0.0, integral_limit=0.0, integral_error=1.0))
    errors = simulate(law, np.array((0.02, 0.0, 0.0)), np.zeros(3), 0.5, np.zeros(3))
    times = np.arange(len(errors)) * STEP
    np.testing.assert_allclose(errors, 0.02 * np.exp(-gain * times), atol=0.02 * 0.01)


def test_a_push_has_a_higher_gain_in_the_plane_for_what_is_beyond_its_threshold() -> None:
    law = Law(DcmLaw(OMEGA, 5.0, 0.0, 0.0, 1.0, push_gain=15.0, push_error=0.02))

    def answer(*error: float) -> np.ndarray:
        """Of the law to an error: where its VRP lies before the DCM, as a gain times a length [m/s]."""
        acceleration = law.acceleration(np.array(error), np.array(error), np.zeros(3), STEP)
        return -acceleration / OMEGA

    np.testing.assert_allclose(answer(0.02, 0.0, 0.0), (0.1, 0.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(answer(0.0, -0.06, 0.0), (0.0, -5.0 * 0.06 - 15.0 * 0.04, 0.0), atol=1e-12)
    np.testing.assert_allclose(answer(0.03, 0.04, 0.1), (0.15 + 0.27, 0.2 + 0.36, 0.5), atol=1e-12)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3))
def test_no_more_is_asked_for_in_the_plane_than_the_grip_and_heights_are_left_alone(error: tuple[float, ...]) -> None:
    free, held = GRIPS
    wanted, given_way = (law.acceleration(np.zeros(3), np.array(error), np.zeros(3), STEP) for law in (free, held))
    size = float(np.hypot(*wanted[:2]))
    np.testing.assert_allclose(given_way[:2], wanted[:2] * min(1.0, 4.0 / size) if size else 0.0, atol=1e-9)
    assert given_way[2] == pytest.approx(wanted[2])


def test_numbers_that_are_none_stay_none() -> None:
    """So that the QP refuses them, where a limit would make a command of them."""
    error = np.array((np.nan, 0.0, 0.0))
    for law in GRIPS:
        assert np.isnan(law.acceleration(np.zeros(3), error, np.zeros(3), STEP)[0])
        law.integral[:] = 0.0


def test_a_wrong_model_ends_in_the_integral_and_not_in_the_error() -> None:
    """A constant acceleration of 0.15 m/s² is a mass that is wrong by 1.5 %."""
    push = np.array((0.15, 0.0, 0.0))
    without = Law(DcmLaw(OMEGA, 5.0, 0.0, 0.0, 0.05))
    assert simulate(without, np.zeros(3), np.zeros(3), 10.0, push)[-1] > 0.005
    law = Law(DcmLaw(OMEGA, 5.0, 1.0, 0.05, 0.05))
    assert simulate(law, np.zeros(3), np.zeros(3), 10.0, push)[-1] == pytest.approx(0.0, abs=1e-4)
    assert law.integral[0] == pytest.approx(0.15 / OMEGA**2, rel=0.01)


def test_the_integral_is_slow_to_believe_a_push_and_is_bounded() -> None:
    law = Law(DcmLaw(OMEGA, 5.0, 1.0, 0.05, integral_error=0.01))
    for _ in range(500):
        law.acceleration(np.zeros(3), np.array((0.1, -0.1, 0.005)), np.zeros(3), 0.002)
    np.testing.assert_allclose(law.integral, (0.01, -0.01, 0.005))  # after one second
    for _ in range(10000):
        law.acceleration(np.zeros(3), np.array((0.1, -0.1, 0.0)), np.zeros(3), 0.002)
    np.testing.assert_allclose(law.integral, (0.05, -0.05, 0.005))


@given(st.floats(0.1, 10.0), st.floats(0.0, 1.0))
def test_minimum_jerk_has_the_derivatives_it_claims(duration: float, share: float) -> None:
    time, step = share * duration, 1e-5 * duration
    time = min(max(time, step), duration - 2.0 * step)
    s, rate, acceleration = map(float, minimum_jerk(time, duration))
    before, after = (tuple(map(float, minimum_jerk(time + way, duration))) for way in (-step, step))
    assert 0.0 <= s <= 1.0
    assert rate * duration == pytest.approx((after[0] - before[0]) / (2.0 * step) * duration, abs=1e-5)
    assert acceleration * duration**2 == pytest.approx((after[1] - before[1]) / (2.0 * step) * duration**2, abs=1e-4)


def test_minimum_jerk_begins_and_ends_at_rest() -> None:
    at_ends = [tuple(map(float, minimum_jerk(time, 2.0))) for time in (0.0, 2.0, 5.0)]
    assert at_ends == [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 0.0, 0.0)]


class Follower:
    def __init__(self, place: np.ndarray) -> None:
        self.state, self._next, self._target, self._dt = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), np.zeros(1)
        self.state[0] = place
        self._evaluate = Kernel(
            "follower", lambda state, target, dt: [followed(state, target, 20.0, dt)],
            (self.state, self._target, self._dt), (self._next,),
        )  # fmt: skip

    def update(self, target: np.ndarray, dt: float) -> None:
        self._target[:], self._dt[0] = target, dt
        self._evaluate()
        self.state[:] = self._next


def test_follower_follows_without_overshoot_and_has_its_derivatives() -> None:
    dt = 0.002
    follower = Follower(np.array((1.0, -2.0, 0.0)))
    target = np.array((2.0, -2.0, 0.5))
    values = [follower.state.copy()]
    for _ in range(500):
        follower.update(target, dt)
        values.append(follower.state.copy())
    states = np.array(values)
    np.testing.assert_allclose(states[-1, 0], target, atol=1e-4)
    assert (states[:, 0, 0] <= 2.0 + 1e-9).all()
    np.testing.assert_allclose(np.diff(states[:, 0], axis=0) / dt, states[1:, 1], atol=1e-9)
    np.testing.assert_allclose(np.diff(states[:, 1], axis=0) / dt, states[1:, 2], atol=1e-9)
