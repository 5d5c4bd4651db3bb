"""The state codec: bounds hold for all inputs, what is beyond is clamped and flagged, garbage raises one error."""

import contextlib
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.examples import examples
from harness.places import ROBOTS
from valor.common.arrays import FloatArray
from valor.link.codec import KEPT, SCALES, Codec, Receiver, Sender, Unpacker, pack, residual, take_residual
from valor.link.errors import CodecError
from valor.link.fields import BY_NAME, Layout, from_smallest_three, smallest_three
from valor.link.state import RobotState
from valor.robot.description import RobotDescription

pytestmark = pytest.mark.portable

ROBOT = RobotDescription.load(ROBOTS / "escher")
LAYOUT = Layout(ROBOT)
CODEC = Codec(LAYOUT)
WILD = st.sampled_from((np.nan, np.inf, -np.inf, 1e300))
HALF = LAYOUT.step / 2 * (1 + 1e-6)


@st.composite
def vectors(draw: Any, beyond: float = 0.0) -> FloatArray:
    """Values (N,) within the ranges, or beyond them by so many ranges either way."""
    seed = draw(st.integers(0, 2**32 - 1))
    spread = draw(st.sampled_from((0.001, 0.1, 1.0)))
    random = np.random.default_rng(seed)
    middle, width = (LAYOUT.low + LAYOUT.high) / 2, LAYOUT.high - LAYOUT.low
    values: FloatArray = middle + width * spread * (0.5 + beyond) * random.uniform(-1.0, 1.0, LAYOUT.size)
    return values


def close(received: FloatArray, sent: FloatArray) -> bool:
    return bool((np.abs(received - sent) <= HALF + 1e-9).all())


@examples(60)
@given(vectors(), st.none() | vectors(), st.integers(1, KEPT - 1))
def test_values_within_range_arrive_within_half_a_step(
    values: FloatArray, before: FloatArray | None, distance: int
) -> None:
    reference = None if before is None else CODEC.quantise(before)
    data = CODEC.encode(CODEC.quantise(values), reference, distance)
    frame = CODEC.decode(data, reference)
    assert close(frame.values, values) and not frame.clamped.any()
    assert CODEC.distance(data) == (0 if reference is None else distance)


@examples(100)
@given(vectors(beyond=2.0), st.lists(st.tuples(st.integers(0, LAYOUT.size - 1), WILD)))
def test_beyond_its_range_a_value_is_clamped_and_flagged(values: FloatArray, wild: list[tuple[int, float]]) -> None:
    for place, value in wild:
        values[place] = value
    frame = CODEC.decode(CODEC.encode(CODEC.quantise(values)))
    outside = ~((values >= LAYOUT.low - HALF) & (values <= LAYOUT.high + HALF))
    assert (frame.clamped == outside).all() and (np.abs(frame.values - values) <= HALF + 1e-9)[~outside].all()
    assert ((frame.values >= LAYOUT.low) & (frame.values <= LAYOUT.high + 1e-9)).all()


@examples(200)
@given(st.binary(max_size=150), st.booleans())
def test_garbage_raises_the_codecs_error_alone(data: bytes, with_reference: bool) -> None:
    reference = CODEC.quantise(np.zeros(LAYOUT.size)) if with_reference else None
    with contextlib.suppress(CodecError):
        CODEC.decode(data, reference)


@examples(100)
@given(st.integers(-(2**38), 2**38), st.integers(1, SCALES - 1))
def test_residuals_come_back(value: int, scale: int) -> None:
    unpacker = Unpacker(pack(residual(value, scale)))
    assert take_residual(unpacker, scale) == value
    unpacker.finish()


@examples(200)
@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 1e-3))
def test_an_orientation_arrives_within_two_milliradians(quaternion: list[float]) -> None:
    q = np.array(quaternion) / np.linalg.norm(quaternion)
    state = RobotState(joints=np.zeros(len(ROBOT.joints)), base_orientation=q)
    frame = CODEC.decode(CODEC.encode(CODEC.quantise(state.vector(LAYOUT))))
    received = RobotState.of(frame, LAYOUT).base_orientation
    assert 2 * np.arccos(min(1.0, abs(float(received @ q)))) <= 0.002
    assert abs(float(from_smallest_three(*smallest_three(q)) @ q)) == pytest.approx(1.0)


def test_a_state_comes_back_field_by_field() -> None:
    n = len(ROBOT.joints)
    state = RobotState(
        joints=np.linspace(0.0, 0.01, n), clock=123456789, stamp=98765, base_position=np.array((12.3, -4.5, 0.9)),
        foot_forces=np.array((1.0, 2.0, 600.0, 3.0, 4.0, 20.0)), mode="walk", requested_mode="stand",
        mode_status=8, mode_age=0.4, behavior="walk", behavior_age=0.1, contacts=2, fault_level=1, faults=7, step=3,
    )  # fmt: skip
    back = RobotState.of(CODEC.decode(CODEC.encode(CODEC.quantise(state.vector(LAYOUT)))), LAYOUT)
    for name in ("clock", "stamp", "mode", "requested_mode", "mode_status", "behavior", "contacts", "fault_level",
                 "faults", "step"):  # fmt: skip
        assert getattr(back, name) == getattr(state, name), name
    for name in ("mode_age", "behavior_age"):
        assert 0.0 <= getattr(back, name) - getattr(state, name) + 1e-9 <= 0.05 + 2e-9, "an upper bound"
    assert np.abs(back.base_position - state.base_position).max() <= 0.002 + 1e-9
    assert np.abs(back.joints - state.joints).max() <= 0.001 + 1e-9
    assert np.abs(back.foot_forces - state.foot_forces).max() <= 5.0 + 1e-9


@pytest.mark.parametrize("age", [0.0, 0.05, 0.13, 0.5, 2.6, 2.95, 7.0, np.inf])
def test_the_age_of_the_last_velocity_is_told_as_an_upper_bound_and_needs_no_flag(age: float) -> None:
    state = RobotState(joints=np.zeros(len(ROBOT.joints)), mode_age=0.0, behavior_age=0.0, velocity_age=age)
    frame = CODEC.decode(CODEC.encode(CODEC.quantise(state.vector(LAYOUT))))
    assert not frame.clamped.any()
    told, field = RobotState.of(frame, LAYOUT).velocity_age, BY_NAME["velocity_age"]
    assert told >= age - 1e-9
    assert told - age <= field.step + 1e-9 if age < field.high - field.step else told == np.inf


@examples(60)
@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=60), st.integers(0, 2**32 - 1))
def test_whatever_is_lost_what_comes_decodes(fates: list[tuple[bool, bool]], seed: int) -> None:
    sender, receiver, random = Sender(CODEC), Receiver(CODEC), np.random.default_rng(seed)
    values = (LAYOUT.low + LAYOUT.high) / 2
    for number, (arrives, acknowledged) in enumerate(fates):
        values = values + LAYOUT.step * random.integers(-3, 4, LAYOUT.size)
        values = np.clip(values, LAYOUT.low, LAYOUT.high)
        data = sender.encode(values, number)
        if arrives:
            assert close(receiver.decode(data, number).values, values)
            if acknowledged:
                sender.acknowledged(number)


def test_a_still_robot_costs_a_fifth_once_a_frame_is_acknowledged() -> None:
    sender, values = Sender(CODEC), (LAYOUT.low + LAYOUT.high) / 2
    alone = len(sender.encode(values, 1))
    sender.acknowledged(1)
    values = values.copy()
    values[LAYOUT.slices["clock"]] += 500
    values[LAYOUT.slices["stamp"]] += 500
    assert len(sender.encode(values, 2)) < alone / 5
    assert len(sender.encode(values, 2 + KEPT)) == alone, "the receiver no longer has a frame so old"


def test_a_reference_that_is_not_there_is_named() -> None:
    frame = CODEC.quantise((LAYOUT.low + LAYOUT.high) / 2)
    with pytest.raises(CodecError, match="missing"):
        Receiver(CODEC).decode(CODEC.encode(frame, frame, 1), 5)


@pytest.mark.parametrize("robot", ["thor"])
def test_other_robots_have_a_layout_too(robot: str) -> None:
    layout = Layout(RobotDescription.load(ROBOTS / robot))
    codec = Codec(layout)
    values = (layout.low + layout.high) / 2
    assert (np.abs(codec.decode(codec.encode(codec.quantise(values))).values - values) <= layout.step).all()
