"""What `walk` asks for: refused before anything moves if it makes no sense; and back to the line if it is straight."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.motion_states import motion_state
from harness.places import ROBOTS
from valor.common.errors import ValorError
from valor.robot.description import RobotDescription
from valor.valorctl.steering import SIDEWAYS, TURNING, Line
from valor.valorctl.walking import Order, _Run


@pytest.mark.parametrize(
    ("order", "words"),
    [
        ({"forward": math.nan, "seconds": 1.0}, "--vx nan: expected a finite number"),
        ({"forward": 0.1, "distance": math.inf}, "--distance inf: expected a finite number"),
        ({"forward": 0.1, "seconds": 0.0}, "--for 0: expected more than 0"),
        ({"turn": 0.1, "distance": 1.0}, "--distance 1: expected --vx or --vy"),
        ({"forward": 0.1, "turn": 0.1, "seconds": 1.0, "straight": True}, "--straight keeps the heading"),
        ({"forward": 0.1}, "--for or --distance"),
        ({"seconds": 1.0}, "where to walk: expected --vx, --vy or --wz other than 0"),
    ],
)
def test_orders_that_make_no_sense_are_refused(order: dict[str, Any], words: str) -> None:
    with pytest.raises(ValorError, match=words):
        Order(**order)


@pytest.mark.parametrize("robot", ["escher", "thor"])
def test_velocities_beyond_what_the_robot_walks_are_refused_with_its_limits(robot: str) -> None:
    limits = RobotDescription.load(ROBOTS / robot).tables.walking
    order = Order(limits.max_forward_speed, -limits.max_lateral_speed, limits.max_turn_rate, seconds=1.0)
    order.require_within(limits, robot)
    for beyond, words in (
        ({"forward": limits.max_forward_speed + 0.01}, f"to {limits.max_forward_speed:g} m/s"),
        ({"forward": -limits.max_backward_speed - 0.01}, f"-{limits.max_backward_speed:g} to"),
        ({"left": limits.max_lateral_speed + 0.01}, f"--vy {limits.max_lateral_speed + 0.01:g}: {robot} walks at"),
        ({"turn": -limits.max_turn_rate - 0.01}, f"{limits.max_turn_rate:g} rad/s"),
    ):
        with pytest.raises(ValorError, match=words):
            Order(**dict[str, Any](beyond), seconds=1.0).require_within(limits, robot)


@given(
    heading=st.floats(-3.0, 3.0), forward=st.floats(-0.3, 0.5), left=st.floats(-0.2, 0.2),
    offset=st.floats(-1.0, 1.0), off=st.floats(-0.5, 0.5),
)  # fmt: skip
def test_a_robot_beside_its_line_is_led_back_to_it(
    heading: float, forward: float, left: float, offset: float, off: float
) -> None:
    """A point that obeys at once ends on the line with its first heading, and never faster than asked for sideways."""
    if math.hypot(forward, left) < 0.05:
        return
    line = Line(motion_state(position=(1.0, 2.0), heading=heading), forward, left)
    direction = heading + math.atan2(left, forward)
    along = np.array([math.cos(direction), math.sin(direction)])
    normal = np.array([-along[1], along[0]])
    place, psi = np.array([1.0, 2.0]) + offset * normal, heading + off
    for _ in range(600):
        state = motion_state(position=(place[0], place[1]), heading=psi)
        x, y, turn = line.steer(state)
        velocity = np.array([x * math.cos(psi) - y * math.sin(psi), x * math.sin(psi) + y * math.cos(psi)])
        assert velocity @ along == pytest.approx(math.hypot(forward, left))
        assert abs(velocity @ normal) <= SIDEWAYS + 1e-9
        assert abs(turn) <= TURNING
        place, psi = place + 0.1 * velocity, psi + 0.1 * turn
    way, beside = line.place(motion_state(position=(place[0], place[1]), heading=psi))
    assert abs(beside) < 0.01
    assert abs(line.turned(motion_state(position=(place[0], place[1]), heading=psi))) < 0.01
    assert way == pytest.approx(60.0 * math.hypot(forward, left), rel=1e-3)


def test_a_walk_ends_where_robot_time_begins_anew() -> None:
    run = _Run(Order(forward=0.3, seconds=60.0), motion_state(time=50 * 10**9))
    walked = [motion_state((0.3 * i, 0.0), time=(50 + i) * 10**9) for i in range(4)]
    assert list(run.consider([*walked, motion_state(time=10**9), motion_state(time=2 * 10**9)])) == walked
    assert run.over
    result = run.result(None)
    assert result.duration == 3.0
    assert result.distance == pytest.approx(0.9)
    assert "restarted" in result.reason
