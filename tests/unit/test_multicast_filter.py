"""The multicast CAN bus: each end hears the kinds of frames that it asked for, and does not wake up for others."""

from __future__ import annotations

import select
from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from valor.common.instance import Settings
from valor.devices import can_frames
from valor.devices.can_frames import Code
from valor.devices.ports import open_can

BUS = 7  # that no robot has
PATIENCE = 5.0  # [s]


@pytest.fixture
def settings(ros_domain: int) -> Settings:
    return Settings(robot=Path(), ros_domain_id=ros_domain)


@pytest.fixture
def ends(settings: Settings) -> Iterator[tuple[can.BusABC, can.BusABC]]:
    master = open_can(settings, BUS, can_frames.TO_MASTER, can_frames.KIND)
    unit = open_can(settings, BUS, can_frames.TO_UNITS, can_frames.KIND)
    yield master, unit
    master.shutdown()
    unit.shutdown()


def heard(bus: can.BusABC, count: int) -> list[int]:
    frames = [bus.recv(PATIENCE) for _ in range(count)]
    return [frame.arbitration_id for frame in frames if frame is not None]


def wakes(bus: can.BusABC) -> bool:
    return bool(select.select([bus.fileno()], [], [], 0.0)[0])


def test_each_end_hears_the_other_and_not_itself(ends: tuple[can.BusABC, can.BusABC]) -> None:
    master, unit = ends
    asked = [can_frames.sync(1), can_frames.request(3, Code.IDENTIFY), can_frames.frame(can_frames.COMMAND + 127, b"")]
    for frame in asked:
        master.send(frame)
    assert heard(unit, 3) == [frame.arbitration_id for frame in asked]
    assert not wakes(master), "what it says itself does not wake it"
    said = [can_frames.frame(can_frames.STATE + 1, bytes(48)), can_frames.frame(can_frames.REPLY + 2, bytes(32))]
    for frame in said:
        unit.send(frame)
    assert heard(master, 2) == [frame.arbitration_id for frame in said]
    assert not wakes(unit)


@pytest.mark.parametrize("identifier", [0x000, 0x07F, 0x080, 0x0FF, 0x100, 0x17F, 0x180, 0x1FF, 0x200, 0x27F, 0x7FF])
def test_a_frame_gets_through_if_its_kind_is_listened_to(settings: Settings, identifier: int) -> None:
    bus = open_can(settings, BUS, can_frames.TO_MASTER, can_frames.KIND)
    try:
        bus.send(can_frames.frame(identifier, b"x"))
        bus.send(can_frames.frame(can_frames.STATE, b"the last"))
        first = heard(bus, 1)
    finally:
        bus.shutdown()
    listened = identifier & can_frames.KIND in can_frames.TO_MASTER
    one_byte = identifier < 0x80  # python-can packs it otherwise; then whoever reads decides
    assert first == [identifier if listened or one_byte else can_frames.STATE]
