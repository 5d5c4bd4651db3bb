"""Frames of motor controllers and force/torque sensors: what was said is understood, what was damaged is refused."""

from __future__ import annotations

import struct

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from valor.devices import can_frames
from valor.devices.can_frames import AXES, COMMAND_TYPE, Code, Identity, Status
from valor.devices.end_to_end import is_sound, protect

units = st.integers(1, 63)
floats = st.floats(width=32, allow_nan=False, allow_infinity=False)
axis = st.tuples(floats, floats, floats, floats, floats)
text = st.text(st.characters(min_codepoint=33, max_codepoint=126), min_size=1, max_size=8)


@given(units, st.integers(0, 0xFFFF), st.lists(st.integers(0, 3), min_size=2, max_size=2), axis, axis)
def test_a_command_arrives_as_it_was_sent(
    unit: int, sequence: int, mode: list[int], first: tuple[float, ...], second: tuple[float, ...]
) -> None:
    commands = np.zeros(1, dtype=COMMAND_TYPE)
    commands[0]["sequence"], commands[0]["mode"] = sequence, mode
    commands[0]["axis"][0], commands[0]["axis"][1] = first, second
    (message,) = can_frames.command_frames([unit], commands)
    assert message.arbitration_id == can_frames.COMMAND + unit
    assert len(message.data) == can_frames.COMMAND_LENGTH
    read = can_frames.read_command(message)
    assert read is not None
    assert int(read["sequence"]) == sequence
    assert list(read["mode"]) == mode
    assert tuple(read["axis"][0]) == first
    assert tuple(read["axis"][1]) == second


@given(units, st.sampled_from(list(Code)), st.booleans(), text, text)
def test_an_answer_arrives_as_it_was_sent(unit: int, code: Code, done: bool, serial: str, firmware: str) -> None:
    message = can_frames.reply(unit, code, done, Identity(serial, firmware))
    reply = can_frames.read_reply(message)
    assert reply == can_frames.Reply(code, done, Identity(serial, firmware))


@given(st.integers(0, 255))
def test_a_counter_arrives_as_it_was_sent(counter: int) -> None:
    assert can_frames.read_small(can_frames.sync(counter)) == counter


@given(units, st.binary(min_size=2, max_size=60), st.data())
def test_a_frame_with_one_wrong_byte_is_refused(unit: int, content: bytes, data: st.DataObject) -> None:
    frame = bytearray(protect(can_frames.STATE + unit, content))
    assert is_sound(can_frames.STATE + unit, frame)
    place = data.draw(st.integers(0, len(frame) - 1))
    frame[place] ^= data.draw(st.integers(1, 255))
    assert not is_sound(can_frames.STATE + unit, frame)


@given(units, units, st.binary(min_size=2, max_size=60))
def test_a_frame_of_another_unit_is_refused(sender: int, reader: int, content: bytes) -> None:
    frame = protect(can_frames.STATE + sender, content)
    assert is_sound(can_frames.STATE + reader, frame) is (sender == reader)


@given(st.binary(max_size=64))
def test_random_bytes_are_no_command_and_no_answer(data: bytes) -> None:
    message = can_frames.frame(can_frames.COMMAND + 1, data)
    # One frame of 65,536 has a right checksum by chance; then it is a command like any other.
    sound = len(data) == can_frames.COMMAND_LENGTH and is_sound(message.arbitration_id, data)
    assert (can_frames.read_command(message) is not None) is sound
    message = can_frames.frame(can_frames.REPLY + 1, data)
    assert (can_frames.read_reply(message) is None) or len(data) == can_frames.REPLY_LENGTH


def test_frames_have_lengths_that_can_fd_knows() -> None:
    known = {*range(9), 12, 16, 20, 24, 32, 48, 64}
    controller = can_frames.CONTROLLER_STATE.size + 2
    sensor = can_frames.SENSOR_STATE.size + 2
    assert (controller, sensor) == (can_frames.CONTROLLER_STATE_LENGTH, can_frames.SENSOR_STATE_LENGTH)
    assert {controller, sensor, can_frames.COMMAND_LENGTH, can_frames.REPLY_LENGTH} <= known
    assert COMMAND_TYPE.itemsize + 2 == can_frames.COMMAND_LENGTH
    assert struct.calcsize("<4f") * AXES + 16 == controller
    assert max(Status) < 256
