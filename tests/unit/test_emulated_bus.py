"""The emulated CAN bus: each end hears the other one alone, and frames that are sent together arrive together."""

from __future__ import annotations

import select
from pathlib import Path

from valor.common.instance import Settings
from valor.devices import can_frames
from valor.devices.can_frames import Code, Frame
from valor.devices.ports import CanBus, open_can

BUS = 7  # that no robot has
PATIENCE = 5.0  # [s]


def wakes(bus: CanBus) -> bool:
    return bool(select.select([bus.fileno()], [], [], 0.0)[0])


def test_each_end_hears_the_other_and_not_itself(ros_domain: int) -> None:
    settings = Settings(robot=Path(), ros_domain_id=ros_domain)
    master, unit, another = (open_can(settings, BUS, master=each) for each in (True, False, False))
    asked = [can_frames.sync(1), can_frames.request(3, Code.IDENTIFY), Frame(can_frames.COMMAND + 127, b"")]
    master.send(asked)
    assert unit.receive(PATIENCE) == another.receive(PATIENCE) == asked
    assert not wakes(master), "what it says itself does not wake it"
    said = [Frame(can_frames.STATE + 1, bytes(48)), Frame(can_frames.REPLY + 2, bytes(32))]
    unit.send(said)
    assert master.receive(PATIENCE) == said
    assert not wakes(unit) and not wakes(another)
    for bus in (master, unit, another):
        bus.close()
