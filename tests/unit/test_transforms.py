"""Lookups of transforms: chains, interpolation in time, errors."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from valor.common.poses import Pose, interpolate, level
from valor.common.transforms import TooNewError, TransformBuffer, TransformError

SECOND = 10**9
numbers = st.floats(-3.0, 3.0)
poses = st.builds(
    lambda p, v: Pose(p, tuple(Rotation.from_rotvec(v).as_quat(scalar_first=True).tolist())),
    st.tuples(numbers, numbers, numbers),
    st.tuples(numbers, numbers, numbers),
)


def matrix(pose: Pose) -> np.ndarray:
    made = np.eye(4)
    made[:3, :3] = Rotation.from_quat(pose.orientation, scalar_first=True).as_matrix()
    made[:3, 3] = pose.position
    return made


def close(pose: Pose, expected: np.ndarray) -> None:
    np.testing.assert_allclose(matrix(pose), expected, atol=1e-9)


@given(poses, poses)
def test_poses_chain_like_matrices(a: Pose, b: Pose) -> None:
    close(a @ b, matrix(a) @ matrix(b))
    close(a.inverse(), np.linalg.inv(matrix(a)))
    np.testing.assert_allclose(a.rotation, matrix(a)[:3, :3], atol=1e-12)
    assert math.isclose(math.cos(a.tilt), matrix(a)[2, 2], abs_tol=1e-9)
    if a.tilt < 1.5:
        assert math.isclose(math.remainder(a.yaw - math.atan2(matrix(a)[1, 0], matrix(a)[0, 0]), math.tau), 0.0,
                            abs_tol=1e-7)  # fmt: skip


@given(poses, poses, st.floats(0.0, 1.0))
def test_between_two_poses(a: Pose, b: Pose, share: float) -> None:
    between = interpolate(a, b, share)
    wanted = (1 - share) * np.array(a.position) + share * np.array(b.position)
    np.testing.assert_allclose(between.position, wanted, atol=1e-12)
    first, second, mid = (Rotation.from_quat(each.orientation, scalar_first=True) for each in (a, b, between))
    whole = (first.inv() * second).magnitude()
    assert math.isclose((first.inv() * mid).magnitude(), share * whole, abs_tol=1e-6)


@given(poses, poses)
def test_displacement_in_the_plane(a: Pose, b: Pose) -> None:
    moved = a.plane_to(b) @ a
    np.testing.assert_allclose(moved.position, b.position, atol=1e-9)
    assert math.isclose(moved.tilt, a.tilt, abs_tol=1e-6)
    if max(a.tilt, b.tilt) < 1.0:
        assert abs(math.remainder(moved.yaw - b.yaw, math.tau)) < 1e-6


@pytest.fixture
def buffer() -> TransformBuffer:
    """odom ─► base ─► foot; map ─► odom and base ─► camera static; base goes 1 m/s along x for 10 s from 100 s."""
    made = TransformBuffer(history=5.0)
    made.add("map", "odom", 0, level(1.0, 2.0, 0.0, math.pi / 2), static=True)
    made.add("base", "camera", 0, level(0.1, 0.0, 1.0, 0.0), static=True)
    for i in range(101):
        made.add("odom", "base", 100 * SECOND + i * SECOND // 10, level(0.1 * i, 0.0, 0.8, 0.0))
    made.add("base", "foot", 109 * SECOND, level(0.0, 0.1, -0.8, 0.0))
    made.add("base", "foot", 110 * SECOND, level(0.0, 0.2, -0.8, 0.0))
    return made


def test_up_down_and_across(buffer: TransformBuffer) -> None:
    close(buffer.lookup("odom", "base", 109 * SECOND), matrix(level(9.0, 0.0, 0.8, 0.0)))
    close(buffer.lookup("base", "odom", 109 * SECOND), matrix(level(-9.0, 0.0, -0.8, 0.0)))
    close(buffer.lookup("foot", "camera", 109 * SECOND), matrix(level(0.1, -0.1, 1.8, 0.0)))
    close(buffer.lookup("/odom", "map"), matrix(level(-2.0, 1.0, 0.0, -math.pi / 2)))
    close(buffer.lookup("odom", "odom"), np.eye(4))


def test_between_times_and_newest(buffer: TransformBuffer) -> None:
    close(buffer.lookup("odom", "base", 109 * SECOND + 40_000_000), matrix(level(9.04, 0.0, 0.8, 0.0)))
    close(buffer.lookup("odom", "foot"), matrix(level(10.0, 0.2, 0.0, 0.0)))
    buffer.add("odom", "base", 111 * SECOND, level(11.0, 0.0, 0.8, 0.0))
    close(buffer.lookup("odom", "foot"), matrix(level(10.0, 0.2, 0.0, 0.0)))  # the newest that all of the way knows


@pytest.mark.parametrize(
    ("target", "source", "time", "error", "text"),
    [
        ("odom", "moon", 0, TransformError, "frame 'moon' is unknown"),
        ("moon", "odom", 0, TransformError, "frame 'moon' is unknown"),
        ("odom", "island", 0, TransformError, "'island' and 'odom' are not connected"),
        ("odom", "base", 112 * SECOND, TooNewError, "112.000 s is 2.000 s ahead of the latest"),
        ("odom", "base", 104 * SECOND, TransformError, "104.000 s is 1.000 s before the oldest"),
        ("odom", "foot", 108 * SECOND, TransformError, "1.000 s before the oldest"),
        ("odom", "a", 0, TransformError, "go in a circle"),
    ],
)
def test_what_cannot_be_said_is_a_stated_error(
    buffer: TransformBuffer, target: str, source: str, time: int, error: type[TransformError], text: str
) -> None:
    buffer.add("sea", "island", 0, Pose(), static=True)
    buffer.add("a", "b", 0, Pose(), static=True)
    buffer.add("b", "a", 0, Pose(), static=True)
    with pytest.raises(TransformError, match=text) as raised:
        buffer.lookup(target, source, time)
    assert type(raised.value) is error


def test_a_clock_that_begins_anew(buffer: TransformBuffer) -> None:
    buffer.add("odom", "base", 1 * SECOND, level(0.5, 0.0, 0.8, 0.0))
    close(buffer.lookup("odom", "base"), matrix(level(0.5, 0.0, 0.8, 0.0)))


def test_a_new_parent(buffer: TransformBuffer) -> None:
    buffer.add("map", "base", 120 * SECOND, level(1.0, 0.0, 0.0, 0.0))
    close(buffer.lookup("map", "base"), matrix(level(1.0, 0.0, 0.0, 0.0)))


@pytest.mark.parametrize(
    ("parent", "child", "pose"),
    [
        ("odom", "base", Pose((math.nan, 0.0, 0.0))),
        ("odom", "base", Pose(orientation=(0.0, 0.0, 0.0, 0.0))),
        ("odom", "base", Pose(orientation=(math.nan, 0.0, 0.0, 1.0))),
        ("odom", "odom", Pose()),
        ("", "base", Pose()),
    ],
)
def test_what_is_no_transform_is_not_taken(buffer: TransformBuffer, parent: str, child: str, pose: Pose) -> None:
    before = buffer.lookup("odom", "base")
    with pytest.raises(ValueError, match="transform from"):
        buffer.add(parent, child, 111 * SECOND, pose)
    assert buffer.lookup("odom", "base") == before
