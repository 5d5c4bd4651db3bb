"""Trajectories: refused when broken, continuous, through their points, within limits."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.examples import examples
from valor.common.arrays import FloatArray
from valor.robot.commanded_limits import CommandedLimits
from valor.valor_ros_controller.trajectory.admission import begin, check_waypoints
from valor.valor_ros_controller.trajectory.execution import Trajectory
from valor.valor_ros_controller.trajectory.waypoints import ErrorCode, InvalidTrajectoryError, Point

NAMES = ("shoulder", "elbow", "wrist")
LIMITS = CommandedLimits(
    NAMES,
    ("rad",) * 3,
    np.array([-3.0, -0.5, -np.inf]),
    np.array([1.0, 3.6, np.inf]),
    velocity=np.array([2.0, 2.0, 6.0]),
    acceleration=np.array([20.0, 20.0, 60.0]),
    effort=np.full(3, np.inf),
)
REST = np.zeros((3, 3))
NOW = 5_000_000_000


Numbers = Sequence[float]


def point(
    time: float, positions: Numbers, velocities: Numbers = (), accelerations: Numbers = (), effort: Numbers = ()
) -> Point:
    return Point(positions, velocities, accelerations, effort, time)


def sample(trajectory: Trajectory, now: int) -> FloatArray:
    state = np.zeros((3, len(NAMES)))
    trajectory.sample(now, state)
    return state


def refusal(names: Sequence[str], points: Sequence[Point], **options: Any) -> InvalidTrajectoryError:
    with pytest.raises(InvalidTrajectoryError) as error:
        check_waypoints(names, points, LIMITS, **options)
    return error.value


GOOD = [point(1.0, [0.5, 0.5, 0.5]), point(2.0, [0.0, 1.0, 2.0])]


@pytest.mark.parametrize(
    ("names", "points", "code", "words"),
    [
        (("shoulder", "elbow", "knee"), GOOD, ErrorCode.INVALID_JOINTS, ("knee", "wrist")),
        (("shoulder", "elbow", "elbow"), GOOD, ErrorCode.INVALID_JOINTS, ("elbow", "twice")),
        (("shoulder", "elbow"), GOOD, ErrorCode.INVALID_JOINTS, ("wrist", "allow_partial_joints_goal")),
        ((), GOOD, ErrorCode.INVALID_JOINTS, ("no joint names",)),
        (NAMES, [], ErrorCode.INVALID_GOAL, ("no points",)),
        (NAMES, [point(1, [0, 0])], ErrorCode.INVALID_GOAL, ("2 positions", "expected 3")),
        (NAMES, [point(1, [0, 0, 0], [0, 0])], ErrorCode.INVALID_GOAL, ("2 velocities", "expected 3")),
        (NAMES, [point(1, [], [0, 0, 0])], ErrorCode.INVALID_GOAL, ("0 positions",)),
        (NAMES, [point(1, [0, math.nan, 0])], ErrorCode.INVALID_GOAL, ("elbow", "nan", "finite")),
        (NAMES, [point(1, [0, 0, math.inf])], ErrorCode.INVALID_GOAL, ("wrist", "inf", "finite")),
        (NAMES, [point(1, [0, 0, 0], [0, math.nan, 0])], ErrorCode.INVALID_GOAL, ("velocities", "elbow")),
        (NAMES, [point(-1, [0, 0, 0])], ErrorCode.INVALID_GOAL, ("-1", "expected 0 or more")),
        (NAMES, [GOOD[1], GOOD[0]], ErrorCode.INVALID_GOAL, ("point 1", "not after")),
        (NAMES, [GOOD[0], GOOD[0]], ErrorCode.INVALID_GOAL, ("point 1", "not after")),
        (NAMES, [point(9, [1.2, 0, 0])], ErrorCode.INVALID_GOAL, ("shoulder", "1.2", "-3 to 1")),
        (NAMES, [point(9, [0, -0.6, 0])], ErrorCode.INVALID_GOAL, ("elbow", "-0.6", "-0.5 to 3.6")),
        (NAMES, [point(1, [0, 0, 0]), point(2, [0, 2.5, 0])], ErrorCode.INVALID_GOAL, ("elbow", "2.5 rad/s", "2 rad/")),
        (NAMES, [point(1, [0, 0, 0], [0, 0, 7]), point(9, [0, 0, 0])], ErrorCode.INVALID_GOAL, ("wrist", "7", "6")),
        (NAMES, [point(1, [0, 0, 0], [0, 0, 1])], ErrorCode.INVALID_GOAL, ("wrist", "last point")),
        (NAMES, [point(1, [0, 0, 0], effort=[1, 1, 1])], ErrorCode.INVALID_GOAL, ("effort",)),
        (NAMES, [point(1, [0, 0, 0], [0, 0, 0], [0, 1e308, 0]), point(2, [0, 0, 0], [0, 0, 0], [0, 0, 0])],
         ErrorCode.INVALID_GOAL, ("elbow", "at inf rad/s", "2 rad/")),
        # Way-points within the limits, the spline between them not.
        (NAMES, [point(1, [0.9, 0, 0], [1.5, 0, 0]), point(2, [0.9, 0, 0], [0, 0, 0])], ErrorCode.INVALID_GOAL,
         ("shoulder", "-3 to 1")),
    ],
)  # fmt: skip
def test_broken_trajectories_are_refused_with_the_reason(
    names: Sequence[str], points: Sequence[Point], code: ErrorCode, words: str
) -> None:
    error = refusal(names, points)
    assert error.code is code
    for word in words:
        assert word in str(error)


def test_partial_goals_are_taken_where_allowed_and_the_rest_holds() -> None:
    waypoints = check_waypoints(["wrist"], [point(1.0, [2.0])], LIMITS, allow_partial=True)
    trajectory = begin(waypoints, 0, NOW, np.array([[0.1, 0.2, 0.3], *REST[1:]]), LIMITS, since=NOW)
    assert sample(trajectory, NOW + 500_000_000)[0] == pytest.approx([0.1, 0.2, 1.15])
    assert sample(trajectory, trajectory.end)[0] == pytest.approx([0.1, 0.2, 2.0])


def test_names_in_another_order_are_mapped() -> None:
    waypoints = check_waypoints(["wrist", "shoulder", "elbow"], [point(2.0, [3.0, 1.0, 2.0])], LIMITS)
    trajectory = begin(waypoints, 0, NOW, REST, LIMITS, since=NOW)
    assert sample(trajectory, trajectory.end)[0] == pytest.approx([1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("end", "middle"),
    [
        (point(2.0, [1.0, 1.0, 1.0]), (0.5, 0.5)),
        (point(2.0, [1.0, 1.0, 1.0], [0, 0, 0]), (0.5, 0.75)),
        (point(2.0, [1.0, 1.0, 1.0], [0, 0, 0], [0, 0, 0]), (0.5, 0.9375)),
    ],
)
def test_interpolation_is_linear_cubic_or_quintic_by_what_the_points_give(end: Point, middle: Any) -> None:
    trajectory = begin(check_waypoints(NAMES, [end], LIMITS), 0, NOW, REST, LIMITS, since=NOW)
    position, velocity, _ = sample(trajectory, NOW + 1_000_000_000)
    assert (position[0], velocity[0]) == pytest.approx(middle)


def begun(points: Sequence[Point], start: int = 0, now: int = NOW, state: FloatArray = REST) -> Trajectory:
    return begin(check_waypoints(NAMES, points, LIMITS), start, now, state, LIMITS, since=now)


def begin_refusal(*args: Any, **options: Any) -> InvalidTrajectoryError:
    with pytest.raises(InvalidTrajectoryError) as error:
        begun(*args, **options)
    return error.value


def test_a_first_point_that_the_speed_limits_do_not_allow_is_refused() -> None:
    error = begin_refusal([point(0.1, [1.0, 0.0, 0.0])])
    assert error.code is ErrorCode.INVALID_GOAL
    assert "shoulder" in str(error) and "10 rad/s" in str(error) and "2 rad/s" in str(error)


class Planned(NamedTuple):
    """Points of a trajectory: time (m,) [s]; position, velocity, acceleration (m, n) [rad, rad/s, rad/s²]."""

    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray


def planned(start: FloatArray, end: FloatArray, points: int) -> Planned:
    """A straight path as MoveIt times it: accelerate, cruise, brake within 0.8 rad/s and 4 rad/s²; at equal times."""
    way = end - start
    farthest = np.abs(way).max()
    speed, push = 0.8 / farthest, 0.5 * 4.0 / farthest
    ramp = min(speed / push, np.sqrt(1.0 / push))
    cruise = push * ramp
    duration = ramp + 1.0 / cruise
    time = np.linspace(0.0, duration, points)
    up, down, left = time < ramp, time > duration - ramp, duration - time
    share = np.select([up, down], [0.5 * push * time**2, 1.0 - 0.5 * push * left**2], cruise * (time - 0.5 * ramp))
    rate = np.select([up, down], [push * time, push * left], cruise)
    gain = np.select([up, down], [push, -push], 0.0)
    return Planned(time, start + np.outer(share, way), np.outer(rate, way), np.outer(gain, way))


@pytest.mark.parametrize("points", [5, 50, 500])
@pytest.mark.parametrize("off", [0.01, 0.05])
def test_a_dense_plan_that_begins_beside_the_set_point_is_joined_where_there_is_time(points: int, off: float) -> None:
    """A planner starts at measured joints: to be where it says at its second point, 5 ms on, would take 10 rad/s."""
    plan = planned(np.array([off, -off, 0.0]), np.array([0.8, 0.3, -0.4]), points)
    sent = [
        point(float(t), p.tolist(), v.tolist(), a.tolist())
        for t, p, v, a in zip(plan.time, plan.position, plan.velocity, plan.acceleration, strict=True)
    ]
    trajectory = begun(sent)
    times = np.arange(0.0, plan.time[-1], 0.002)
    states = np.array([sample(trajectory, NOW + round(t * 1e9)) for t in times])
    assert states[0, 0] == pytest.approx([0, 0, 0]), "the set-point must not jump"
    assert (np.abs(states[:, 1]) <= LIMITS.fastest).all()
    assert np.abs(np.diff(states[:, 0], axis=0)).max() <= LIMITS.fastest.max() * 0.002
    there = np.stack([np.interp(times, plan.time, column) for column in plan.position.T], axis=1)
    apart = np.abs(states[:, 0] - there).max(axis=1)
    assert trajectory.end == NOW + round(plan.time[-1] * 1e9)
    if points > 5:
        assert apart.max() <= off + 0.02
        assert apart[times > 0.45].max() < 1e-3


def test_a_plan_of_nearly_nothing_is_taken_from_beside_its_start() -> None:
    sent = [point(i * 0.002, [0.02 - i * 1e-5, 0.0, 0.0], [0.0] * 3) for i in range(50)]
    assert sample(begun(sent), NOW + 98_000_000)[0] == pytest.approx([0.02 - 49e-5, 0, 0])


def test_a_point_at_time_zero_tells_where_the_sender_thinks_we_are() -> None:
    near = [point(0.0, [0.05, 0.0, 0.0]), point(1.0, [0.5, 0.0, 0.0])]
    trajectory = begun(near)
    assert sample(trajectory, NOW)[0] == pytest.approx([0, 0, 0]), "the set-point must not jump"
    error = begin_refusal([point(0.0, [0.5, 0.0, 0.0]), point(1.0, [0.5, 0.0, 0.0])])
    assert "shoulder is 0.5 rad away from the first point" in str(error)
    assert begin_refusal([point(0.0, [0.0, 0.0, 0.0])]).code is ErrorCode.INVALID_GOAL


def test_header_stamps() -> None:
    later = begun([point(1.0, [0.5, 0, 0])], start=NOW + 1_000_000_000)
    assert later.end == NOW + 2_000_000_000
    assert begin_refusal(GOOD, start=NOW - 3_000_000_000).code is ErrorCode.OLD_HEADER_TIMESTAMP
    past = begun(GOOD, start=NOW - 1_200_000_000)  # its first point is over: on to the second from here
    assert sample(past, NOW)[0] == pytest.approx([0, 0, 0])
    assert past.end == NOW + 800_000_000
    wall = begin_refusal(GOOD, start=1_700_000_000_000_000_000)
    assert wall.code is ErrorCode.INVALID_GOAL and "another clock" in str(wall)


def test_stopping_decelerates_each_joint_as_told_and_stays() -> None:
    velocity, deceleration = np.array([1.0, -0.5, 0.0]), np.array([10.0, 2.5, 10.0])
    trajectory = Trajectory.stopping(NOW, np.zeros(3), velocity, deceleration, LIMITS)
    assert trajectory.end == NOW + 200_000_000
    times = np.arange(NOW, trajectory.end, 1_000_000)
    since = (times - NOW) * 1e-9
    states = np.array([sample(trajectory, int(t)) for t in times])
    assert states[:, 1, 0] == pytest.approx(np.maximum(0.0, 1.0 - 10.0 * since), abs=1e-9)
    assert states[:, 1, 1] == pytest.approx(-0.5 + 2.5 * since, abs=1e-9)
    assert (np.abs(np.diff(states[:, 0], axis=0)) <= np.abs(velocity) * 1e-3 + 1e-12).all(), "a jump"
    assert sample(trajectory, trajectory.end + 1)[0] == pytest.approx([0.05, -0.05, 0.0])


rests = st.tuples(*(st.tuples(st.floats(0.0, 1.0), st.floats(-6, 6), st.floats(0.01, 100)) for _ in NAMES))


@examples(60)
@given(rests)
def test_stopping_anywhere_ends_at_rest_within_the_limits_without_a_jump(joints: Any) -> None:
    fraction, speed, deceleration = np.array(joints).T
    lower, upper = np.maximum(LIMITS.lower, -9.0), np.minimum(LIMITS.upper, 9.0)
    position = lower + fraction * (upper - lower)
    velocity = np.clip(speed, -LIMITS.velocity, LIMITS.velocity)
    trajectory = Trajectory.stopping(NOW, position, velocity, deceleration, LIMITS)
    times = np.linspace(NOW, trajectory.end, 200).astype(np.int64)
    states = np.array([sample(trajectory, int(t)) for t in times])
    moved = np.abs(np.diff(states[:, 0], axis=0))
    longest = np.diff(times)[:, None] * 1e-9 * np.abs(velocity)
    assert (moved <= longest * (1 + 1e-6) + 1e-6).all(), "a jump"
    assert (states[:, 0] >= LIMITS.lower - 1e-6).all() and (states[:, 0] <= LIMITS.upper + 1e-6).all()
    assert (sample(trajectory, trajectory.end)[1] == 0).all()


def test_a_trajectory_is_asked_about_any_time_without_being_moved() -> None:
    trajectory = begun([point(1.0, [0.5, 0, 0]), point(2.0, [0.0, 0, 0])])
    assert trajectory.at(NOW + 1_500_000_000)[0] == pytest.approx([0.25, 0, 0])
    assert trajectory.at(NOW + 500_000_000)[0] == pytest.approx([0.25, 0, 0])
    assert sample(trajectory, NOW + 200_000_000)[0] == pytest.approx([0.1, 0, 0])
    assert trajectory.at(NOW - 1)[0] == pytest.approx([0, 0, 0])
    assert trajectory.at(trajectory.end + 10**9)[0] == pytest.approx([0, 0, 0])


def test_delay_shifts_what_is_to_come() -> None:
    trajectory = begun([point(1.0, [0.5, 0, 0])])
    before = sample(trajectory, NOW + 400_000_000)
    trajectory.delay(2_000_000_000)
    assert sample(trajectory, NOW + 2_400_000_000) == pytest.approx(before)


positions = st.tuples(st.floats(-2.5, 0.9), st.floats(-0.4, 3.4), st.floats(-9, 9))
speeds = st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-3, 3))


@st.composite
def trajectories(draw: st.DrawFn) -> list[Point]:
    """Way-points, slow enough more often than not, of any mixture of what points may carry."""
    time, points = 0.0, list[Point]()
    count = draw(st.integers(1, 5))
    for i in range(count):
        time += draw(st.floats(0.5, 12.0))
        last = i == count - 1
        velocities = draw(st.one_of(st.just(()), st.just((0.0, 0.0, 0.0)) if last else speeds))
        accelerations = draw(st.one_of(st.just(()), speeds)) if velocities else ()
        points.append(point(time, draw(positions), velocities, accelerations))
    return points


@examples(80)
@given(trajectories(), positions)
def test_accepted_trajectories_are_continuous_within_limits_and_through_their_points(
    points: list[Point], here: tuple[float, ...]
) -> None:
    try:
        waypoints = check_waypoints(NAMES, points, LIMITS)
        trajectory = begin(waypoints, 0, NOW, np.array([here, *REST[1:]]), LIMITS, since=NOW)
    except InvalidTrajectoryError as error:
        assert error.code is ErrorCode.INVALID_GOAL
        return
    step = 4_000_000
    times = range(NOW, trajectory.end + step, step)
    states = np.array([sample(trajectory, t) for t in times])
    assert np.isfinite(states).all()
    assert states[0, 0] == pytest.approx(here)
    assert (states[:, 0] >= LIMITS.lower - 1e-3).all() and (states[:, 0] <= LIMITS.upper + 1e-3).all()
    moved = np.abs(np.diff(states[:, 0], axis=0))
    assert (moved <= LIMITS.fastest * 1.01 * step * 1e-9 + 1e-9).all(), "a jump"
    fresh = begun(points, state=np.array([here, *REST[1:]]))
    for way in points:
        through = sample(fresh, NOW + round(way.time_from_start * 1e9))
        assert through[0] == pytest.approx(way.positions, abs=1e-6)


anything = st.floats(allow_nan=True, allow_infinity=True)
sizes = st.lists(anything, max_size=4)


@examples(80)
@given(
    st.lists(st.sampled_from([*NAMES, "knee"]), max_size=4),
    st.lists(st.builds(Point, sizes, sizes, sizes, st.just(()), anything), max_size=4),
)
def test_whatever_comes_is_taken_whole_or_refused_with_a_code(names: list[str], points: list[Point]) -> None:
    try:
        waypoints = check_waypoints(names, points, LIMITS)
    except InvalidTrajectoryError as error:
        assert error.code in (ErrorCode.INVALID_GOAL, ErrorCode.INVALID_JOINTS) and str(error)
        return
    assert np.isfinite(waypoints.coefficients).all()
