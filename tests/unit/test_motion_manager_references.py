"""What the Motion Manager makes of the time and the load that it is told: where a mistake shows late, or little."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.still_robot import Robot
from tests.unit.test_motion_manager_setpoints import ARM, ROBOT, Bench
from valor.common.behaviors import Behavior
from valor.motion_manager.joints.joint_reference import SETPOINT_HORIZON
from valor.robot.posture_move import PostureMove


@given(st.floats(0.3, 5.0), st.floats(0.01, 0.99))
def test_the_acceleration_of_a_move_is_how_its_velocity_changes(shortest: float, share: float) -> None:
    limit = np.full(2, 100.0)
    way = np.array([0.7, -0.2])
    move = PostureMove(np.zeros(2), way, velocity=limit, acceleration=limit, began=2.0, shortest=shortest)
    now, step = 2.0 + share * move.duration, 1e-5 * move.duration
    before, after = move.at(now - step)[1], move.at(now + step)[1]
    np.testing.assert_allclose(move.at(now)[2], (after - before) / (2.0 * step), atol=1e-5 * np.abs(way).max() + 1e-6)


@pytest.mark.parametrize("age", [0.0, 0.25 * SETPOINT_HORIZON, 0.8 * SETPOINT_HORIZON])
def test_a_set_point_runs_on_from_the_moment_that_it_was_made_for(age: float) -> None:
    """And comes to rest where its velocity takes it within the horizon, however late it was heard."""
    bench = Bench(Behavior.STAND_MANIPULATE)
    bench.run(0.5)
    joints = [ROBOT.index[name] for name in ARM]
    here = bench.reference.position[joints]
    speed = 0.2 * ROBOT.velocity_limit[joints]
    assert bench.send(bench.message(list(ARM), here, speed, age=age))
    bench.run(0.5)
    np.testing.assert_allclose(bench.reference.position[joints], here + SETPOINT_HORIZON * speed, atol=1e-6)
    assert not bench.reference.velocity[joints].any()


@pytest.mark.parametrize(("foot", "aside"), [("left", -0.1), ("right", 0.1)])
def test_a_foot_that_does_not_touch_has_no_part_in_the_centre_of_pressure(foot: str, aside: float) -> None:
    robot = Robot()
    robot.run(1.0)
    assert not robot.ask(Behavior.STAND)
    robot.run(0.1)
    state = robot.manager.parts.state
    assert state is not None
    np.testing.assert_allclose(state.cop_in_odom, [0.02, 0.0], atol=1e-9)
    for _ in range(100):
        robot.tick(**dict[str, Any]({f"{foot}_foot_wrench": np.zeros(6)}))
        state = robot.manager.parts.state
        assert state is not None
        if state.contacts.sum() == 1:
            break
    np.testing.assert_allclose(state.cop_in_odom, [0.02, aside], atol=1e-6)
