"""Frames of the HDT modules' bus: what goes in comes out, within what a frame can carry."""

from __future__ import annotations

import math

import can
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valor.common.arrays import FloatArray
from valor.devices import hdt_bus
from valor.devices.hdt_bus import SegmentState, Setpoints

RESOLUTION = {"position": 0.5e-6, "velocity": 0.5e-3, "effort": 0.5e-2, "stiffness": 0.05, "damping": 0.005}
CARRIED = {
    "position": (-2147.483648, 2147.483647),
    "velocity": (-32.768, 32.767),
    "effort": (-327.68, 327.67),
    "stiffness": (0.0, 6553.5),
    "damping": (0.0, 655.35),
}
finite = st.floats(-1e4, 1e4)


def vectors(k: int) -> st.SearchStrategy[FloatArray]:
    return st.lists(finite, min_size=k, max_size=k).map(np.array)


def as_carried(name: str, values: FloatArray) -> FloatArray:
    return np.clip(values, *CARRIED[name])


@given(st.data(), st.integers(1, 4), st.integers(0, 63), st.integers(1, 0xFFFF))
def test_set_points_arrive_as_they_were_sent(data: st.DataObject, k: int, segment: int, sequence: int) -> None:
    modes = np.array(data.draw(st.lists(st.integers(0, 3), min_size=k, max_size=k)), dtype=np.uint8)
    numbers = {name: data.draw(vectors(k)) for name in RESOLUTION}
    frame = hdt_bus.command(segment, sequence, Setpoints(modes, **numbers))
    assert len(frame.data) in can.util.CAN_FD_DLC and frame.is_fd
    assert hdt_bus.kind_and_segment(frame.arbitration_id) == (hdt_bus.COMMAND, segment)
    arrived, setpoints = hdt_bus.parse_command(frame, k)
    assert arrived == sequence and setpoints is not None
    assert setpoints.mode.tolist() == modes.tolist()
    for name, resolution in RESOLUTION.items():
        got = getattr(setpoints, name)
        assert np.abs(got - as_carried(name, numbers[name])).max() <= resolution * 1.01 + 1e-9, name


@given(st.data(), st.integers(1, 4), st.integers(0, 63))
def test_states_arrive_as_they_were_said(data: st.DataObject, k: int, segment: int) -> None:
    numbers = {name: data.draw(vectors(k)) for name in ("position", "velocity", "effort")}
    temperature = np.array(data.draw(st.lists(st.integers(-40, 120), min_size=k, max_size=k)), dtype=float)
    fault = np.array(data.draw(st.lists(st.integers(0, 15), min_size=k, max_size=k)), dtype=np.uint8)
    said = SegmentState(7, 65535, 47.93, *numbers.values(), temperature, fault)  # type: ignore[arg-type, call-arg]
    frame = hdt_bus.state(segment, said)
    assert len(frame.data) in can.util.CAN_FD_DLC
    heard = hdt_bus.parse_state(frame, k)
    assert (heard.command_sequence, heard.sequence) == (7, 65535)
    assert heard.voltage == pytest.approx(47.93)
    assert heard.temperature.tolist() == temperature.tolist() and heard.fault.tolist() == fault.tolist()
    for name, values in numbers.items():
        assert np.abs(getattr(heard, name) - as_carried(name, values)).max() <= RESOLUTION[name] * 1.01 + 1e-9, name


def test_a_command_without_set_points_only_asks() -> None:
    assert hdt_bus.parse_command(hdt_bus.command(3, 12, None), 4) == (12, None)


@pytest.mark.parametrize("parse", [hdt_bus.parse_command, hdt_bus.parse_state])
@given(data=st.binary(max_size=47))
def test_short_frames_are_refused(parse: object, data: bytes) -> None:
    frame = can.Message(arbitration_id=0x100, data=data, is_fd=True, is_extended_id=False, check=False)
    with pytest.raises(hdt_bus.FrameError, match=r"0x100: \d+ bytes, expected"):
        parse(frame, 4)  # type: ignore[operator]


def test_identities_and_nonsense_in_their_place() -> None:
    frame = hdt_bus.identity(5, "HDT-L-0042", "3.1")
    assert len(frame.data) == 64
    assert hdt_bus.parse_identity(frame) == ("HDT-L-0042", "3.1")
    frame.data = bytearray(b"\xff\xfe no text")
    with pytest.raises(hdt_bus.FrameError, match="segment 5"):
        hdt_bus.parse_identity(frame)


@given(st.integers(1, 40))
def test_segments_share_a_limbs_joints_without_gap_or_overlap(joints: int) -> None:
    parts = hdt_bus.segments(joints)
    assert [i for part in parts for i in range(joints)[part]] == list(range(joints))
    assert len(parts) == math.ceil(joints / hdt_bus.JOINTS)
