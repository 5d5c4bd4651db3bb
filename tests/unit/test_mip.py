"""MIP: driver and emulator, written apart, agree; packets are found again after whatever else came."""

import struct

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.places import ROBOTS
from valor.comms_manager.hardware.microstrain import Packet, checksum, decode, encode, packet_stream
from valor.device_emulators.microstrain import MipSensor
from valor.devices import mip
from valor.devices.mip import APPLY, READ, STANDARD_GRAVITY, SYNC, Base, DescriptorSet, FilterData, Result, ThreeDm
from valor.robot.description import RobotDescription
from valor.simulation.plant import Plant
from valor.simulation.sensors import Sensors

FIELDS = st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=40)), min_size=1, max_size=6)
PACKETS = st.builds(lambda s, fields: Packet(s, tuple(fields)), st.integers(0, 255), FIELDS)
ROBOT = RobotDescription.load(ROBOTS / "escher")
MEASURED = Sensors(ROBOT, Plant(ROBOT, "flat", "ideal", 0), ROBOT.tables.actuators["ideal"].noise, 0).measure(1, 1)


def sensor() -> MipSensor:
    return MipSensor("3DM-GX4-25", "6234.12345", "1.1.26")


def decoded(data: bytes) -> list[Packet | None]:
    return [decode(frame) for frame in packet_stream().feed(data)]


def reply(device: MipSensor, descriptor_set: int, command: int, data: bytes = b"") -> Packet:
    (answer,) = device.receive(encode(descriptor_set, [(command, data)]))
    (packet,) = decoded(answer)
    assert packet is not None
    return packet


GARBAGE = st.lists(
    st.one_of(st.binary(max_size=30), st.just(SYNC), st.just(SYNC[:1]), st.just(SYNC + b"\x01\xff"))
).map(b"".join)


@given(st.lists(st.tuples(GARBAGE, PACKETS), max_size=4), GARBAGE, st.integers(1, 300))
def test_every_valid_packet_is_found_among_garbage(parts: list[tuple[bytes, Packet]], tail: bytes, size: int) -> None:
    """A header in the garbage may claim a length that reaches over the packets behind it; pieces are of any size."""
    line = b"".join(garbage + encode(p.descriptor_set, p.fields) for garbage, p in parts) + tail
    line += bytes(300 * (1 + line.count(SYNC)))
    stream = packet_stream()
    found = [decode(frame) for i in range(0, len(line), size) for frame in stream.feed(line[i : i + size])]
    assert [p for p in found if p in [packet for _, packet in parts]] == [packet for _, packet in parts]


@given(PACKETS, st.data())
def test_a_wrong_byte_is_noticed(packet: Packet, data: st.DataObject) -> None:
    frame = bytearray(encode(packet.descriptor_set, packet.fields))
    place = data.draw(st.integers(0, len(frame) - 1))
    frame[place] ^= data.draw(st.integers(1, 255))
    assert packet not in decoded(bytes(frame) + bytes(300))
    if frame[3] <= len(frame) - 6:
        assert sensor().receive(bytes(frame)) == []


def configured(codes: list[int], decimation: int) -> MipSensor:
    device = sensor()
    command = ThreeDm.FILTER_MESSAGE_FORMAT
    entries = bytes((len(codes),)) + b"".join(mip.FORMAT_ENTRY.pack(code, decimation) for code in codes)
    assert reply(device, DescriptorSet.THREE_DM, command, bytes((APPLY,)) + entries).fields[0][1][1] == Result.OK
    read = reply(device, DescriptorSet.THREE_DM, command, bytes((READ, 0)))
    assert read.fields[1][1] == entries
    enable = bytes((APPLY, mip.FILTER_STREAM, 1))
    assert reply(device, DescriptorSet.THREE_DM, ThreeDm.ENABLE_STREAM, enable).fields[0][1][1] == Result.OK
    return device


@pytest.mark.parametrize(("codes", "decimation", "rate"), [
    ([FilterData.ATTITUDE_QUATERNION, FilterData.STATUS], 2, 250), ([FilterData.GPS_TIMESTAMP], 10, 50),
])  # fmt: skip
def test_streams_have_the_requested_rate(codes: list[int], decimation: int, rate: int) -> None:
    device = configured(codes, decimation)
    packets = [packet for k in range(1000) for data in device.stream(k * 1e-3) for packet in decoded(data)]
    assert len(packets) == rate
    assert all(packet and [code for code, _ in packet.fields] == codes for packet in packets)
    reply(device, DescriptorSet.BASE, Base.SET_TO_IDLE)
    assert device.stream(2.0) == []
    reply(device, DescriptorSet.BASE, Base.RESUME)
    assert len(device.stream(3.0)) == 1


def test_missed_packets_are_not_made_up() -> None:
    device = configured([FilterData.STATUS], 2)
    assert [len(device.stream(now)) for now in (0.0, 0.001, 0.5, 0.5, 0.504)] == [1, 0, 1, 0, 1]


@given(st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1))
def test_measurements_are_in_the_vendors_frames(q: tuple[float, ...]) -> None:
    """Sensor and world are rotated by a half turn about x; numbers are big-endian floats."""
    orientation = np.array(q) / np.linalg.norm(q)
    device = configured([FilterData.ATTITUDE_QUATERNION, FilterData.COMPENSATED_ANGULAR_RATE], 2)
    MEASURED.imu_orientation, MEASURED.imu_angular_velocity = orientation, np.array([0.5, 0.25, -4.0])
    MEASURED.imu_linear_acceleration = np.array([0.1, 0.2, STANDARD_GRAVITY])
    device.measure(MEASURED, hot=False)
    assert device.specific_force == (0.1, -0.2, -STANDARD_GRAVITY)
    (packet,) = decoded(device.stream(0.0)[0])
    assert packet is not None
    *quaternion, valid = struct.unpack(">4fH", packet.fields[0][1])
    assert valid and struct.unpack(">3fH", packet.fields[1][1]) == (0.5, -0.25, 4.0, 1)
    over, sent, expected = np.array([0.0, 1.0, 0.0, 0.0]), np.zeros(4), np.zeros(4)
    mujoco.mju_mulQuat(expected, over, orientation)
    mujoco.mju_mulQuat(sent, np.array(quaternion), over)
    assert abs(sent @ expected) == pytest.approx(1.0, abs=1e-6)


def test_fields_that_do_not_fill_the_payload_are_no_packet() -> None:
    frame = SYNC + bytes((0x80, 3)) + bytes((9, 4, 0))
    assert decoded(frame + checksum(frame)) == [None]
