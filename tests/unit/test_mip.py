"""MIP: driver and emulator, written apart, agree; packets are found again after whatever else came."""

from __future__ import annotations

import struct

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valor.comms_manager.hardware.mip import Packet, PacketStream, checksum, encode
from valor.device_emulators import mip_sensor
from valor.device_emulators.mip_sensor import Attitude, MipSensor
from valor.devices.mip import (
    DATA_FIELDS,
    DEVICE_INFORMATION,
    FORMAT_ENTRY,
    STANDARD_GRAVITY,
    SYNC,
    Base,
    DescriptorSet,
    FilterData,
    Function,
    ImuData,
    Reply,
    Result,
    Stream,
    ThreeDm,
)

FIELDS = st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=40)), min_size=1, max_size=6)
PACKETS = st.builds(lambda s, fields: Packet(s, tuple(fields)), st.integers(0, 255), FIELDS)
PING = bytes.fromhex("756501020201e0c6")  # the manual's own example


def sensor() -> MipSensor:
    return MipSensor("3DM-GX4-25", "6234.12345", "1.1.26")


def decoded(data: bytes) -> list[Packet]:
    return list(PacketStream().feed(data))


def reply(device: MipSensor, descriptor_set: int, command: int, data: bytes = b"") -> Packet:
    (answer,) = device.receive(encode(descriptor_set, [(command, data)]))
    (packet,) = decoded(answer)
    return packet


def test_a_ping_is_the_manuals() -> None:
    assert encode(DescriptorSet.BASE, [(Base.PING, b"")]) == PING
    assert reply(sensor(), DescriptorSet.BASE, Base.PING).fields == ((Reply.ACKNOWLEDGE, bytes((Base.PING, 0))),)


@given(st.binary(max_size=300))
def test_both_ends_sum_alike(data: bytes) -> None:
    assert checksum(data) == bytes(mip_sensor._fletcher(data))


@given(st.lists(PACKETS, max_size=5), st.data())
def test_packets_arrive_whatever_pieces_the_line_cuts_them_into(packets: list[Packet], data: st.DataObject) -> None:
    line = b"".join(encode(p.descriptor_set, p.fields) for p in packets)
    stream, found = PacketStream(), list[Packet]()
    while line:
        size = data.draw(st.integers(1, len(line)))
        found += stream.feed(line[:size])
        line = line[size:]
    assert found == packets
    assert (stream.skipped, stream.wrong_checksums, stream.malformed) == (0, 0, 0)


GARBAGE = st.lists(
    st.one_of(st.binary(max_size=30), st.just(SYNC), st.just(SYNC[:1]), st.just(SYNC + b"\x01\xff"))
).map(b"".join)


@given(st.lists(st.tuples(GARBAGE, PACKETS), max_size=4), GARBAGE)
def test_every_sound_packet_is_found_among_garbage(parts: list[tuple[bytes, Packet]], tail: bytes) -> None:
    """A header in the garbage may claim a length that reaches over the packets behind it."""
    line = b"".join(garbage + encode(p.descriptor_set, p.fields) for garbage, p in parts) + tail
    stream = PacketStream()
    found = list(stream.feed(line)) + list(stream.feed(bytes(300 * (1 + line.count(SYNC)))))
    assert [p for p in found if p in [packet for _, packet in parts]] == [packet for _, packet in parts]


@given(PACKETS, st.data())
def test_a_wrong_byte_is_noticed(packet: Packet, data: st.DataObject) -> None:
    frame = bytearray(encode(packet.descriptor_set, packet.fields))
    place = data.draw(st.integers(0, len(frame) - 1))
    frame[place] ^= data.draw(st.integers(1, 255))
    assert packet not in decoded(bytes(frame) + bytes(300))
    if frame[3] <= len(frame) - 6:
        assert sensor().receive(bytes(frame)) == []


def test_fields_that_do_not_fill_the_payload_are_counted() -> None:
    frame = SYNC + bytes((0x80, 3)) + bytes((9, 4, 0))
    stream = PacketStream()
    assert list(stream.feed(frame + checksum(frame))) == []
    assert stream.malformed == 1


def test_a_payload_that_is_too_long_is_refused() -> None:
    with pytest.raises(ValueError, match="255"):
        encode(DescriptorSet.BASE, [(1, bytes(200)), (2, bytes(100))])


def test_the_device_says_who_it_is() -> None:
    packet = reply(sensor(), DescriptorSet.BASE, Base.DEVICE_INFORMATION)
    acknowledge, (descriptor, data) = packet.fields
    assert acknowledge == (Reply.ACKNOWLEDGE, bytes((Base.DEVICE_INFORMATION, Result.OK)))
    assert descriptor == Reply.DEVICE_INFORMATION
    firmware, model, _, serial, _, _ = DEVICE_INFORMATION.unpack(data)
    assert (firmware, model.strip(), serial.strip()) == (1126, b"3DM-GX4-25", b"6234.12345")


@pytest.mark.parametrize(
    ("descriptor_set", "command", "data", "expected"),
    [
        (DescriptorSet.BASE, 0x77, b"", Result.UNKNOWN_COMMAND),
        (0x0D, 0x01, b"", Result.UNKNOWN_COMMAND),
        (DescriptorSet.THREE_DM, ThreeDm.FILTER_MESSAGE_FORMAT, b"", Result.INVALID_PARAMETER),
        (DescriptorSet.THREE_DM, ThreeDm.FILTER_MESSAGE_FORMAT, b"\x01\x02\x03\x00\x01", Result.INVALID_PARAMETER),
        (DescriptorSet.THREE_DM, ThreeDm.FILTER_MESSAGE_FORMAT, b"\x01\x01\x7f\x00\x01", Result.INVALID_PARAMETER),
        (DescriptorSet.THREE_DM, ThreeDm.FILTER_MESSAGE_FORMAT, b"\x01\x01\x03\x00\x00", Result.INVALID_PARAMETER),
        (DescriptorSet.THREE_DM, ThreeDm.ENABLE_STREAM, b"\x01\x02\x01", Result.INVALID_PARAMETER),
    ],
)
def test_the_device_refuses(descriptor_set: int, command: int, data: bytes, expected: Result) -> None:
    assert reply(sensor(), descriptor_set, command, data).fields == ((Reply.ACKNOWLEDGE, bytes((command, expected))),)


def configured(which: Stream, codes: list[int], decimation: int) -> MipSensor:
    device = sensor()
    command = ThreeDm.IMU_MESSAGE_FORMAT if which == Stream.IMU else ThreeDm.FILTER_MESSAGE_FORMAT
    entries = b"".join(FORMAT_ENTRY.pack(code, decimation) for code in codes)
    apply = bytes((Function.APPLY, len(codes))) + entries
    assert reply(device, DescriptorSet.THREE_DM, command, apply).fields[0][1][1] == Result.OK
    read = reply(device, DescriptorSet.THREE_DM, command, bytes((Function.READ, 0)))
    assert read.fields[1][1] == bytes((len(codes),)) + entries
    enable = bytes((Function.APPLY, which, 1))
    assert reply(device, DescriptorSet.THREE_DM, ThreeDm.ENABLE_STREAM, enable).fields[0][1][1] == Result.OK
    return device


@pytest.mark.parametrize(("which", "codes", "decimation", "rate"), [
    (Stream.IMU, [ImuData.SCALED_ACCELEROMETER, ImuData.SCALED_GYROSCOPE, ImuData.QUATERNION], 4, 250),
    (Stream.FILTER, [FilterData.ATTITUDE_QUATERNION, FilterData.STATUS], 2, 250),
    (Stream.FILTER, [FilterData.ATTITUDE_MATRIX], 10, 50),
])  # fmt: skip
def test_streams_come_at_the_rate_asked_for(which: Stream, codes: list[int], decimation: int, rate: int) -> None:
    device = configured(which, codes, decimation)
    packets = [p for k in range(1000) for data in device.stream(k * 1e-3) for p in decoded(data)]
    assert len(packets) == rate
    assert all([code for code, _ in packet.fields] == codes for packet in packets)
    reply(device, DescriptorSet.BASE, Base.SET_TO_IDLE)
    assert device.stream(2.0) == []
    reply(device, DescriptorSet.BASE, Base.RESUME)
    assert len(device.stream(3.0)) == 1


def test_packets_that_were_missed_are_not_made_up() -> None:
    device = configured(Stream.FILTER, [FilterData.STATUS], 2)
    assert [len(device.stream(now)) for now in (0.0, 0.001, 0.5, 0.5, 0.504)] == [1, 0, 1, 0, 1]


@given(st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1))
def test_quaternion_and_matrix_say_the_same_in_the_vendors_frames(q: tuple[float, ...]) -> None:
    """The pelvis' axes in world, turned over: what a vector of the world becomes in the sensor."""
    orientation = np.array(q) / np.linalg.norm(q)
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, orientation)
    over = np.diag((1.0, -1.0, -1.0))  # forward-left-up ↔ forward-right-down
    sensor_in_ned = over @ rotation.reshape(3, 3) @ over
    feels = Attitude.of_pelvis(orientation, np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.2, STANDARD_GRAVITY]))
    np.testing.assert_allclose(np.reshape(feels.matrix(), (3, 3)), sensor_in_ned.T, atol=1e-12)
    assert feels.angular_velocity == (1.0, -2.0, -3.0)
    assert feels.specific_force == (0.1, -0.2, -STANDARD_GRAVITY)


def test_numbers_are_big_endian_floats() -> None:
    device = configured(Stream.IMU, [ImuData.SCALED_ACCELEROMETER, ImuData.SCALED_GYROSCOPE], 4)
    device.attitude = Attitude(angular_velocity=(0.5, -0.25, 4.0))
    (data,) = device.stream(0.0)
    (packet,) = decoded(data)
    assert struct.unpack(">3f", packet.fields[0][1]) == (0.0, 0.0, -1.0)
    assert struct.unpack(">3f", packet.fields[1][1]) == (0.5, -0.25, 4.0)
    assert len(packet.fields[1][1]) == DATA_FIELDS[DescriptorSet.IMU_DATA][ImuData.SCALED_GYROSCOPE].size
