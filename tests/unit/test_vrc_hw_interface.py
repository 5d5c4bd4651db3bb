"""Claims and command rectification: one writer a joint, finite, within limits, no jump."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.examples import examples
from harness.places import ROBOTS
from valor.robot.description import RobotDescription
from valor.valor_ros_controller.valor_escher_hw_interface import LONGEST_STEP, JointClaimError, ValorEscherHWInterface

ROBOT = RobotDescription.load(ROBOTS / "escher")
ARM, NECK = ROBOT.group_indices("left_arm"), ROBOT.group_indices("neck")


def test_a_joint_has_one_writer() -> None:
    hw = ValorEscherHWInterface(ROBOT)
    hw.claim("left", ARM)
    hw.claim("left", ARM)
    with pytest.raises(JointClaimError, match="other and left both write l_elbow_pitch"):
        hw.claim("other", np.array([NECK[0], ARM[3]]))
    hw.claim("neck", NECK)  # a refused claim leaves nothing behind
    hw.release("left")
    hw.claim("other", ARM)


def test_what_is_written_follows_the_writers() -> None:
    hw = ValorEscherHWInterface(ROBOT)
    hw.write("neck", NECK)
    hw.write("left", ARM)
    assert hw.written.tolist() == sorted([*NECK.tolist(), *ARM.tolist()])
    unchanged = hw.written
    hw.write("left", ARM)
    assert hw.written is unchanged
    hw.pause("left")
    assert hw.written.tolist() == NECK.tolist()
    hw.release("neck")
    assert hw.written.size == 0


number = st.one_of(st.floats(-10, 10), st.floats(allow_nan=True, allow_infinity=True))


@examples(100)
@given(st.lists(st.tuples(st.lists(number, min_size=6, max_size=6), st.integers(-5, 400)), min_size=1, max_size=20))
def test_whatever_is_commanded_what_is_sent_is_finite_within_limits_and_near_what_was_sent(
    cycles: list[tuple[list[float], int]],
) -> None:
    hw = ValorEscherHWInterface(ROBOT)
    hw.write("neck", NECK)
    last = np.zeros(2)
    speed = hw.limits(NECK).fastest
    for values, milliseconds in cycles:
        hw.time += milliseconds * 1_000_000
        hw.command_position[NECK] = values[:2]
        hw.command_velocity[NECK] = values[2:4]
        hw.command_acceleration[NECK] = values[4:]
        position, velocity, acceleration = hw.rectify()
        assert np.isfinite([position, velocity, acceleration]).all()
        assert (position >= ROBOT.lower[NECK]).all() and (position <= ROBOT.upper[NECK]).all()
        assert (np.abs(velocity) <= speed).all()
        assert (np.abs(position - last) <= speed * min(LONGEST_STEP, max(0, milliseconds) * 1e-3) + 1e-8).all()
        last = position


@pytest.mark.parametrize("side", ["lower", "upper"])
def test_what_is_asked_for_beyond_a_limit_ends_at_the_limit(side: Any) -> None:
    """Of every joint, the pelvis' six included."""
    hw = ValorEscherHWInterface(ROBOT)
    limits = hw.limits(np.arange(len(hw.names)))
    joints = np.flatnonzero(np.isfinite(limits.lower) & np.isfinite(limits.upper))
    assert set(range(hw.pelvis, hw.pelvis + 6)) | set(ARM) <= set(joints)
    limits = hw.limits(joints)
    limit, way = getattr(limits, side), limits.upper - limits.lower
    beyond = 0.3 if side == "upper" else -0.3
    hw.command_position[joints] = 0.5 * (limits.lower + limits.upper)
    hw.write("all", joints)
    hw.command_position[joints] = limit + beyond
    for _ in range(int((way / limits.velocity).max() / LONGEST_STEP) + 1):
        hw.time += round(1e9 * LONGEST_STEP)
        position, _, _ = hw.rectify()
        assert (position >= limits.lower).all() and (position <= limits.upper).all()
    assert position.tolist() == limit.tolist()


@pytest.mark.parametrize("part", ["command_position", "command_velocity", "command_acceleration"])
def test_a_joint_whose_command_is_not_finite_rests_where_it_was_and_no_other_does(part: str) -> None:
    hw = ValorEscherHWInterface(ROBOT)
    hw.write("neck", NECK)
    hw.command_position[NECK], hw.command_velocity[NECK], hw.command_acceleration[NECK] = 1e-4, 0.2, 0.3
    hw.time += 10_000_000
    getattr(hw, part)[NECK[1]] = np.nan
    assert [values.tolist() for values in hw.rectify()] == [[1e-4, 0.0], [0.2, 0.0], [0.3, 0.0]]
    assert hw.clamped == 1
