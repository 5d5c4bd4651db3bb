"""Which of an encoder's answers are believed: knocks are, jumps and glitches are not."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import assume, example, given
from hypothesis import strategies as st

from harness.examples import examples
from valor.comms_manager.hardware.dynamixel_servo import DOUBTS_TO_FAULT, SMALLEST, EncoderWatch

LIMIT = 6.0  # [rad/s]
CYCLE = 0.02  # [s]
CALM = 10  # answers

Answers = list[tuple[float, float, float]]
"""Position [rad], velocity [rad/s], time [s]."""


def answers(velocities: np.ndarray, jitter: np.ndarray | None = None, lag: float = 0.0) -> Answers:
    """Of a joint whose velocity goes from knot to knot, a cycle each.

    ``jitter``: of the cycles, as shares. ``lag``: share of the last word in each velocity that is said, as of a filter.
    """
    fine = 20
    grid = np.interp(np.arange((len(velocities) - 1) * fine + 1) / fine, np.arange(len(velocities)), velocities)
    way = np.concatenate(([0.0], np.cumsum(0.5 * (grid[1:] + grid[:-1]) * CYCLE / fine)))
    at = np.arange(len(velocities), dtype=float)
    if jitter is not None:
        at[1:-1] += jitter[1 : len(velocities) - 1]
    places = np.interp(at * fine, np.arange(len(grid)), way)
    speeds = np.interp(at * fine, np.arange(len(grid)), grid)
    said = speeds.copy()
    for k in range(1, len(said)):
        said[k] = lag * said[k - 1] + (1.0 - lag) * speeds[k]
    return list(zip(places.tolist(), said.tolist(), (at * CYCLE).tolist(), strict=True))


def hear(told: Answers) -> tuple[EncoderWatch, list[bool]]:
    watch = EncoderWatch(LIMIT)
    return watch, [watch.is_plausible(*answer) for answer in told]


still = np.zeros(CALM)


@examples(80)
@given(
    st.lists(st.floats(-8.0, 8.0), min_size=1, max_size=12), st.lists(st.floats(-0.3, 0.3), min_size=40, max_size=40)
)
def test_a_knock_is_no_jump(changes: list[float], jitter: list[float]) -> None:
    """However quick, to and fro, at up to 400 rad/s²: what moves by the velocity that it says is believed."""
    knock = np.cumsum(changes)
    knock = np.concatenate((knock, np.arange(abs(knock[-1]), 0.0, -8.0)[1:] * np.sign(knock[-1])))
    watch, believed = hear(answers(np.concatenate((still, knock, still)), np.array(jitter)))
    assert not watch.jumped
    assert all(believed)


@examples(60)
@example(speed=15.0, decay=0.5, count=3, side=1.0, lag=0.75)
@given(st.floats(8.0, 30.0), st.floats(0.5, 0.9), st.integers(3, 8), st.sampled_from([1.0, -1.0]), st.floats(0.0, 0.9))
def test_a_knock_that_is_told_late_is_no_jump(speed: float, decay: float, count: int, side: float, lag: float) -> None:
    """Set going at once, slowed down by friction; a servo filters what it says of its velocity."""
    knock = side * speed * decay ** np.arange(count)
    watch, believed = hear(answers(np.concatenate((still, knock, still)), lag=lag))
    assert not watch.jumped
    assert believed[-1]


@examples(80)
@example(speed=25.0, brake=560.0, phase=0.0, side=1.0)
@example(speed=22.0, brake=1300.0, phase=0.2, side=1.0)
@given(st.floats(8.0, 50.0), st.floats(50.0, 1500.0), st.floats(0.0, 0.99), st.sampled_from([1.0, -1.0]))
def test_a_knock_that_the_servo_brakes_is_no_jump(speed: float, brake: float, phase: float, side: float) -> None:
    """Whenever between two answers it comes; the servo stops it within some, and brings the joint back.

    Braked harder, and come far nevertheless, it is there and on its way back by the first answer, as after a jump.
    """
    assume(brake <= 600.0 or speed**2 / (2.0 * brake) < SMALLEST - 0.02)
    fine = CYCLE / 200
    slowed = np.arange(speed, -LIMIT, -brake * fine)
    way = np.cumsum(slowed) * fine
    back = np.full(max(0, math.ceil(way[-1] / (LIMIT * fine))), -LIMIT)
    before = round((CALM + phase) * 200)
    velocity = side * np.concatenate((np.zeros(before), slowed, back, np.zeros(CALM * 200)))
    place = np.cumsum(velocity) * fine
    told = [(float(place[k]), float(velocity[k]), k * fine) for k in range(0, len(place), 200)]
    watch, believed = hear(told)
    assert not watch.jumped
    assert believed[-1]


@examples(80)
@given(
    st.lists(st.floats(-LIMIT, LIMIT), min_size=2 * CALM, max_size=2 * CALM), st.floats(0.25, 3.0),
    st.sampled_from([1.0, -1.0]), st.booleans(),
)  # fmt: skip
def test_a_jump_is_one_whatever_the_joint_does(velocities: list[float], jump: float, side: float, seen: bool) -> None:
    """``seen``: the servo works its velocity out of the same encoder, and so says a great one, once."""
    told = answers(np.array(velocities))
    moved = told[CALM][0] - told[CALM - 1][0]
    jump = side * jump if abs(moved) < 1e-9 else math.copysign(jump, moved)  # otherwise the movement hides some of it
    for k in range(CALM, len(told)):
        position, velocity, time = told[k]
        told[k] = position + jump, velocity + (jump / CYCLE if seen and k == CALM else 0.0), time
    watch, believed = hear(told)
    assert watch.jumped
    assert all(believed[:CALM])
    assert not any(believed[CALM : CALM + DOUBTS_TO_FAULT - 1]), "nothing is taken in before it is known"


@examples(20)
@given(st.floats(0.4, 3.0), st.sampled_from([1.0, -1.0]))
def test_a_glitch_is_not_accepted_and_forgotten(height: float, side: float) -> None:
    told = answers(np.zeros(2 * CALM))
    told[CALM] = (side * height, *told[CALM][1:])
    watch, believed = hear(told)
    assert not watch.jumped
    assert [k for k, each in enumerate(believed) if not each] == [CALM]


def test_after_a_pause_the_joint_may_be_anywhere() -> None:
    watch = EncoderWatch(LIMIT)
    told: Answers = [(0.0, 0.0, 0.0), (2.0, 0.0, 0.5), (2.0, 0.0, 0.52)]
    assert all(watch.is_plausible(*answer) for answer in told)
    watch.reset()
    assert watch.is_plausible(-1.0, 0.0, 0.54)
