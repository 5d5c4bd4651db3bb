"""What stands between any set-point and a joint: limits in position, velocity and acceleration, whatever comes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.examples import examples
from harness.places import ROBOTS
from valor.common.arrays import FloatArray
from valor.motion_manager.joints.joint_reference import JointReference, Setpoint
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription
from valor.robot.limiter import Limiter
from valor.robot.posture_move import PostureMove

ROBOT = RobotDescription.load(ROBOTS / "escher")
LIMITS = CommandedLimits.of_joints(ROBOT)
N = len(ROBOT.joints)
DT = ROBOT.control_period
SLACK = 1.02  # the last step onto a limit may brake so much harder than planned


class Watch:
    """Sees every step of a reference, and that none passes a limit."""

    def __init__(self, position: FloatArray) -> None:
        self.position, self.velocity = position.copy(), np.zeros(N)

    def step(self, position: FloatArray, velocity: FloatArray) -> None:
        assert np.isfinite(position).all()
        assert np.isfinite(velocity).all()
        moved = (position - self.position) / DT
        assert np.allclose(moved, velocity, atol=1e-9) and (np.abs(velocity) <= LIMITS.fastest * (1 + 1e-9)).all()
        jerked = np.abs(velocity - self.velocity) / DT
        assert (jerked <= SLACK * LIMITS.acceleration).all()
        outside = (position < ROBOT.lower - 1e-12) | (position > ROBOT.upper + 1e-12)
        # Outside only where it was found outside, and never further out.
        inwards = np.abs(position - np.clip(position, ROBOT.lower, ROBOT.upper)) <= np.abs(
            self.position - np.clip(self.position, ROBOT.lower, ROBOT.upper)
        )
        assert (~outside | inwards).all()
        self.position, self.velocity = position.copy(), velocity.copy()


@examples(15)
@given(
    st.integers(0, 2**32 - 1),
    st.lists(st.tuples(st.floats(-10, 10), st.floats(-1, 1), st.integers(1, 200)), min_size=1, max_size=12),
)
def test_no_target_however_wild_makes_a_joint_pass_a_limit(seed: int, targets: list[tuple[float, float, int]]) -> None:
    rng = np.random.default_rng(seed)
    limiter = Limiter(LIMITS)
    found = rng.uniform(-3, 3, N)
    limiter.reset(np.ones(N, dtype=bool), found)
    watch = Watch(found)
    for scale, speed, periods in targets:
        target, velocity = scale * rng.uniform(-1, 1, N), speed * rng.choice([-1, 0, 1], N) * ROBOT.velocity_limit
        for _ in range(periods):
            target = target + velocity * DT
            limiter.advance(target, velocity, DT)
            watch.step(limiter.position, limiter.velocity)


def test_taken_up_where_it_was_it_sets_out_again_as_before() -> None:
    """What is asked is then what was asked before, and yet not where it has come to."""
    limiter = Limiter(LIMITS)
    start, still, everything = limiter.position.copy(), np.zeros(N), np.ones(N, dtype=bool)
    goal = np.clip(start + 0.3, ROBOT.lower, ROBOT.upper)
    limiter.advance(goal, still, DT)
    once = limiter.position.copy()
    assert not np.array_equal(once, start)
    limiter.reset(everything, start)
    limiter.advance(goal, still, DT)
    np.testing.assert_array_equal(limiter.position, once)


def test_a_step_is_reached_without_overshoot_as_fast_as_the_limits_allow() -> None:
    limiter = Limiter(LIMITS)
    start = limiter.position.copy()
    goal = np.clip(np.full(N, 0.5), ROBOT.lower, ROBOT.upper)
    way, beyond, arrived = goal - start, np.zeros(N), np.full(N, np.inf)
    for period in range(2000):
        limiter.advance(goal, np.zeros(N), DT)
        beyond = np.maximum(beyond, np.sign(way) * (limiter.position - goal))
        arrived = np.minimum(arrived, np.where(np.abs(limiter.position - goal) < 1e-3, period * DT, np.inf))
    assert beyond.max() < 1e-5
    assert np.abs(limiter.position - goal).max() < 1e-9
    speed, acceleration = LIMITS.fastest, LIMITS.acceleration
    ramp = np.minimum(speed, np.sqrt(np.abs(way) * acceleration))  # peak velocity of the fastest possible move
    fastest = np.abs(way) / ramp + ramp / acceleration
    assert (arrived <= 1.3 * fastest + 0.01).all()


def test_a_trajectory_within_the_limits_is_followed_exactly() -> None:
    limiter = Limiter(LIMITS)
    centre = 0.5 * (np.maximum(ROBOT.lower, -1.0) + np.minimum(ROBOT.upper, 1.0))
    limiter.reset(np.ones(N, dtype=bool), centre)
    amplitude = 0.1 * np.minimum(1.0, ROBOT.velocity_limit)
    for period in range(1, 2000):
        t = period * DT
        target = centre + amplitude * (1 - np.cos(2 * t))
        limiter.advance(target, 2 * amplitude * np.sin(2 * t), DT)
        assert np.abs(limiter.position - target).max() < 1e-12


@examples(25)
@given(st.integers(0, 2**32 - 1), st.floats(0.1, 2.0), st.sampled_from([0.0, 0.4, 0.8]))
def test_a_move_arrives_with_all_joints_together_within_its_limits(seed: int, shortest: float, cruise: float) -> None:
    rng = np.random.default_rng(seed)
    start, goal = rng.uniform(-1, 1, N), rng.uniform(-1, 1, N)
    velocity, acceleration = rng.uniform(0.1, 2, N), rng.uniform(1, 20, N)
    move, slow = (
        PostureMove(
            start, goal, velocity=velocity, acceleration=acceleration, began=5.0, shortest=shortest, cruise=share
        )
        for share in (cruise, 0.0)
    )
    assert shortest <= move.duration <= slow.duration
    times = np.linspace(5.0, 5.0 + move.duration, 201)
    samples = [move.at(float(t)) for t in times]
    position, rate, change = (np.array(column) for column in zip(*samples, strict=True))
    assert np.allclose(position[0], start) and np.allclose(position[-1], goal)
    assert (np.abs(rate) <= velocity * (1 + 1e-9)).all()
    assert (np.abs(change) <= acceleration * (1 + 1e-9)).all()
    assert np.allclose(np.gradient(position, times, axis=0)[1:-1], rate[1:-1], atol=0.02 * velocity.max())
    assert np.allclose(np.gradient(rate, times, axis=0)[1:-1], change[1:-1], atol=0.05 * acceleration.max())
    assert np.allclose(move.at(1e3)[0], goal) and not move.at(1e3)[1].any()


def test_a_long_move_at_steady_velocity_takes_little_longer_than_at_full_velocity() -> None:
    velocity, acceleration, goal = np.full(2, 2.0), np.full(2, 20.0), np.array([6.0, -3.0])
    move = PostureMove(
        np.zeros(2), goal, velocity=velocity, acceleration=acceleration, began=0.0, shortest=0.1, cruise=0.8
    )
    assert 3.0 < move.duration < 1.15 * 3.0


def everything() -> np.ndarray:
    return np.ones(N, dtype=bool)


@examples(15)
@given(st.data())
def test_no_sequence_of_holds_moves_and_set_points_makes_a_joint_jump(data: st.DataObject) -> None:
    reference = JointReference(ROBOT)
    reference.take_up(everything(), ROBOT.nominal_posture)
    watch, now = Watch(ROBOT.nominal_posture), 0.0
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    for what in data.draw(st.lists(st.sampled_from(["hold", "move", "follow", "wait"]), max_size=15)):
        some = rng.random(N) < 0.5
        if what == "hold":
            reference.hold(some)
        elif what == "move":
            reference.move(some, np.clip(rng.uniform(-2, 2, N), ROBOT.lower, ROBOT.upper), now)
        elif what == "follow" and some.any():
            places = np.flatnonzero(some)
            k = len(places)
            limit = ROBOT.velocity_limit[places]
            reference.follow(
                Setpoint(
                    places, np.clip(rng.uniform(-4, 4, k), ROBOT.lower[places], ROBOT.upper[places]),
                    rng.uniform(-1, 1, k) * limit, rng.uniform(-1, 1, k) * LIMITS.acceleration[places],
                    now + rng.uniform(-0.5, 0.1),
                )
            )  # fmt: skip
        for _ in range(int(rng.integers(1, 120))):
            now += DT
            reference.advance(now, DT)
            watch.step(reference.position, reference.velocity)


def test_a_set_point_takes_its_joints_out_of_a_move_and_leaves_the_rest_in_it() -> None:
    reference = JointReference(ROBOT)
    reference.take_up(everything(), ROBOT.nominal_posture)
    goal = np.clip(ROBOT.nominal_posture + 0.3, ROBOT.lower, ROBOT.upper)
    arm = ROBOT.group_indices("left_arm")
    reference.move(everything(), goal, 0.0)
    for period in range(2000):
        if period == 100:
            k = len(arm)
            reference.follow(Setpoint(arm, ROBOT.nominal_posture[arm], np.zeros(k), np.zeros(k), period * DT))
        reference.advance(period * DT, DT)
    rest = np.setdiff1d(np.arange(N), arm)
    assert np.allclose(reference.position[arm], ROBOT.nominal_posture[arm], atol=1e-9)
    assert np.allclose(reference.position[rest], goal[rest], atol=1e-9)


@pytest.mark.parametrize("missed", [1, 5, 10])
def test_a_longer_period_keeps_the_limits_too(missed: int) -> None:
    limiter = Limiter(LIMITS)
    goal = np.clip(np.full(N, 2.0), ROBOT.lower, ROBOT.upper)
    for _ in range(1000):
        before = limiter.velocity.copy()
        limiter.advance(goal, np.zeros(N), missed * DT)
        assert (np.abs(limiter.velocity) <= LIMITS.fastest * (1 + 1e-9)).all()
        allowed = SLACK * LIMITS.acceleration * missed * DT
        assert (np.abs(limiter.velocity - before) <= allowed + 1e-9).all()
    assert np.allclose(limiter.position, goal, atol=1e-6)


def test_a_target_that_is_no_number_does_not_become_one() -> None:
    """Whoever sends the command must be able to refuse it."""
    limiter = Limiter(LIMITS)
    target = np.zeros(N)
    target[3] = np.nan
    limiter.advance(target, np.zeros(N), DT)
    assert np.flatnonzero(~np.isfinite(limiter.position)).tolist() == [3]
