"""The support polygon, and the three ways to notice that the robot is lost."""

import dataclasses

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from harness.closed_loop import ClosedLoop
from harness.waiting import some
from valor.common import rotation
from valor.control.fall import FallDetector, corners_on_ground, inner_radius, sole_corners, surely_within
from valor.control.state import RobotState
from valor.control.tuning_tables import Tuning
from valor.robot.description import RobotDescription
from valor.robot.soles import Point, convex_hull, distance_outside

MILLISECOND = 1_000_000  # [ns]
coordinates = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))


def area(polygon: list[Point]) -> float:
    following = polygon[1:] + polygon[:1]
    return 0.5 * sum(ax * by - bx * ay for (ax, ay), (bx, by) in zip(polygon, following, strict=True))


@given(st.integers(0, 2**32 - 1), st.integers(3, 20))
def test_hull_is_scipys(seed: int, count: int) -> None:
    points = np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 2))
    hull = convex_hull([(x, y) for x, y in points.tolist()])
    assert {tuple(corner) for corner in points[ConvexHull(points).vertices].tolist()} == set(hull)
    assert area(hull) == pytest.approx(ConvexHull(points).volume)  # counter-clockwise: positive


@given(st.lists(coordinates, min_size=3, max_size=8), coordinates)
@example([(0.0, 0.0), (0.0, 1.0), (1.0, 1.0), (8.8e-224, 0.0)], (0.0, 0.0))  # two corners that are all but one
def test_distance_to_the_hull_is_that_of_a_dense_outline(points: list[Point], point: Point) -> None:
    hull = convex_hull(points)
    if len(hull) < 3 or area(hull) < 1e-3:
        return
    distance = distance_outside(hull, *point)
    share = np.linspace(0.0, 1.0, 400)[:, None]
    corners = np.array(hull)
    outline = np.concatenate([a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    nearest = np.hypot(*(outline - point).T).min()
    assert abs(distance) == pytest.approx(nearest, abs=0.01)
    edges = [(b - a, np.array(point) - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    inside = all(e[0] * p[1] - e[1] * p[0] > 0.0 for e, p in edges)
    assert inside == (distance < 0.0) or nearest < 1e-9


small = st.floats(-0.35, 0.35)
apart = st.tuples(st.floats(-0.6, 0.6), st.floats(0.0, 0.6), st.floats(-0.2, 0.2))


@given(apart, st.tuples(small, small, small), st.tuples(small, small, small), coordinates, st.floats(0.0, 0.1))
def test_what_is_surely_within_is_within(
    robot: RobotDescription,
    left: tuple[float, float, float],
    turned_left: tuple[float, float, float],
    turned_right: tuple[float, float, float],
    point: Point,
    margin: float,
) -> None:
    feet = robot.tables.feet
    positions = np.array((left, (0.0, 0.0, 0.0)))
    rotations = np.array([rotation.from_rotation_vector(np.array(turn)) for turn in (turned_left, turned_right)])
    x, y = 0.6 * point[0], 0.6 * point[1]
    outside = distance_outside(convex_hull(corners_on_ground(sole_corners(feet), positions, rotations)), x, y)
    within = surely_within(positions, rotations, inner_radius(feet), (x, y), margin)
    assert not within or outside <= margin + 1e-9
    middle = positions.mean(axis=0)
    assert surely_within(positions, rotations, inner_radius(feet), (middle[0], middle[1]), 0.0)


@pytest.fixture(scope="module")
def standing(robot: RobotDescription) -> RobotState:
    loop = ClosedLoop(robot)
    loop.run(0.1)
    return loop.state


def dcm_at(robot: RobotDescription, state: RobotState, outside: float, milliseconds: int) -> RobotState:
    """The state later, its DCM ahead of the middle of the support polygon's front by ``outside`` [m]."""
    corners = sole_corners(robot.tables.feet)
    ground = corners_on_ground(corners, state.sole_positions_in_odom, state.sole_rotations_in_odom)
    dcm = np.array((max(x for x, _ in ground) + outside, float(state.sole_positions_in_odom[:, 1].mean()), 0.86))
    return dataclasses.replace(state, dcm_in_odom=dcm, time=state.time + milliseconds * MILLISECOND)


def turned(state: RobotState, tilt: float) -> RobotState:
    c, s = np.cos(tilt), np.sin(tilt)
    rotation = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    return dataclasses.replace(state, pelvis_rotation_in_odom=rotation)


def test_tilt(robot: RobotDescription, standing: RobotState) -> None:
    limit = robot.read(Tuning).fall.tilt
    assert FallDetector(robot).update(turned(standing, limit - 0.01)) is None
    reason = some(FallDetector(robot).update(turned(standing, limit + 0.02)))
    assert reason.startswith("pelvis tilted") and f"limit {np.degrees(limit):.0f}°" in reason


def test_height(robot: RobotDescription, standing: RobotState) -> None:
    lowest = robot.read(Tuning).fall.height * robot.tables.nominal_base_height
    low = standing.pelvis_position_in_odom * (1.0, 1.0, 0.0) + (0.0, 0.0, lowest - 0.01)
    reason = FallDetector(robot).update(dataclasses.replace(standing, pelvis_position_in_odom=low))
    assert reason == f"pelvis {lowest - 0.01:.2f} m above the soles, limit {lowest:.2f} m"


def test_dcm_outside_the_polygon_for_long_enough(robot: RobotDescription, standing: RobotState) -> None:
    margin, duration = robot.read(Tuning).fall.dcm_margin, round(robot.read(Tuning).fall.dcm_duration * 1e3)
    detector = FallDetector(robot)
    assert detector.update(dcm_at(robot, standing, -0.005, 0)) is None
    assert detector.update(dcm_at(robot, standing, margin - 0.005, 2)) is None
    assert detector.update(dcm_at(robot, standing, margin + 0.005, 4)) is None
    assert detector.update(dcm_at(robot, standing, margin + 0.005, 4 + duration - 2)) is None
    reason = some(detector.update(dcm_at(robot, standing, margin + 0.005, 4 + duration)))
    assert reason.startswith(f"DCM {margin + 0.005:.3f} m outside the support polygon")
    assert reason.endswith(f"limit {margin:.3f} m")


def test_dcm_that_comes_back_begins_anew(robot: RobotDescription, standing: RobotState) -> None:
    margin, duration = robot.read(Tuning).fall.dcm_margin, round(robot.read(Tuning).fall.dcm_duration * 1e3)
    detector = FallDetector(robot)
    assert detector.update(dcm_at(robot, standing, margin + 0.01, 0)) is None
    assert detector.update(dcm_at(robot, standing, -0.02, 2)) is None
    assert detector.update(dcm_at(robot, standing, margin + 0.01, duration + 2)) is None
    detector.reset()
    assert detector.update(dcm_at(robot, standing, margin + 0.01, 2 * duration + 2)) is None
