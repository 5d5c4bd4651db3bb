"""The driver of the motor controllers: what it sends to whom, and which positions it believes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.places import ROBOTS
from valor.common.arrays import FloatArray
from valor.common.instance import Instance, Settings
from valor.common.messages import JointMode
from valor.comms_manager.hardware.device import DeviceContext, Fault, JointCommands, JointMeasurement
from valor.comms_manager.hardware.series_elastic import JUMPS_TO_FAULT, SeriesElastic
from valor.devices import can_frames
from valor.devices.can_frames import Frame, Status, is_valid, protect
from valor.devices.ports import open_can
from valor.devices.table import SeaCanFd
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(ROBOTS / "escher")
TABLE: Any = ROBOT.tables.devices["legs"]
assert isinstance(TABLE, SeaCanFd)
NAMES = TABLE.joints
OFFSET = np.array([ROBOT.tables.calibration.offsets.get(joint, 0.0) for joint in NAMES])
ON = int(Status.ENABLED | Status.CALIBRATED)


class Bench:
    """A driver on a bus within this process, and the bus' far end in a test's hands."""

    def __init__(self, name: str) -> None:
        settings = Settings(robot=ROBOT.folder, ros_domain_id=1, ports={"can0": f"virtual:{name}"})
        self.driver = SeriesElastic("legs", DeviceContext(Instance("x", Path()), settings, ROBOT))
        self.driver._bus = open_can(settings, 0, master=True)
        self.far = open_can(settings, 0, master=False)
        self.clock, self.period = 0, 4000  # [µs]

    def exchange(self, encoders: FloatArray, status: int = ON, but: frozenset[int] = frozenset()) -> JointMeasurement:
        """One SYNC, answered by all but some; returns what the driver hands over."""
        self.driver._sync()
        counter = None
        for message in self.far.receive(0.0):
            if message.identifier == can_frames.SYNC:
                counter = can_frames.read_small(message)
        assert counter is not None
        self.clock += self.period
        rows = iter(encoders)
        for unit in TABLE.controllers:
            axes = [[next(rows), 0.1, 2.0, 0.2] for _ in unit.axes]
            axes += [[0.0] * 4] * (can_frames.AXES - len(axes))
            if unit.id not in but:
                content = can_frames.CONTROLLER_STATE.pack(
                    counter, status, 0, *axes[0], *axes[1], 300, 310, 4800, self.clock
                )
                identifier = can_frames.STATE + unit.id
                self.far.send([Frame(identifier, protect(identifier, content))])
        self.driver._listen(0.0)
        self.driver._finish()
        assert isinstance(self.driver.joint_state, JointMeasurement)
        return self.driver.joint_state

    def commands(self) -> dict[int, np.void]:
        told = [frame for frame in self.far.receive(0.0) if can_frames.is_command(frame)]
        assert all(frame.identifier & can_frames.KIND == can_frames.COMMAND for frame in told)
        units = [frame.identifier & can_frames.UNIT for frame in told]
        return dict(zip(units, can_frames.read_commands(told), strict=True))


@pytest.fixture
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    bench = Bench(request.node.name)
    yield bench
    bench.far.close()
    bench.driver.close()


def command(mode: JointMode = JointMode.IMPEDANCE) -> JointCommands:
    m = len(NAMES)
    position, velocity, effort, stiffness, damping = (np.arange(m, dtype=float) + 0.125 * k for k in range(5))
    return JointCommands(70_000, np.full(m, mode, dtype=np.uint8), position, velocity, effort, stiffness, damping)


def test_every_axis_gets_its_own_command_with_its_offset(bench: Bench) -> None:
    bench.driver.command = sent = command()
    bench.driver._send_command()
    told = bench.commands()
    assert list(told) == [unit.id for unit in TABLE.controllers]
    row = 0
    for unit in TABLE.controllers:
        received = told[unit.id]
        assert int(received["sequence"]) == 70_000 & 0xFFFF
        for axis in range(len(unit.axes)):
            expected = (sent.position[row] + OFFSET[row], *(v[row] for v in (
                sent.velocity, sent.effort, sent.stiffness, sent.damping)))  # fmt: skip
            assert received["mode"][axis] == JointMode.IMPEDANCE
            assert tuple(received["axis"][axis]) == pytest.approx(expected, rel=1e-6)
            row += 1
    assert told[7]["mode"][1] == JointMode.OFF, "the axis that is not there is off"
    bench.driver._send_command()
    assert bench.commands() == {}, "a command is sent once"


def test_states_are_joint_positions_and_time_is_the_controllers(bench: Bench) -> None:
    rest = np.linspace(-0.3, 0.3, len(NAMES))
    for _ in range(3):
        measured = bench.exchange(rest + OFFSET)
    assert measured.position == pytest.approx(rest, abs=1e-6) and measured.effort == pytest.approx(2.0)
    assert bench.driver.elapsed == 2 * 4_000_000, "between three SYNCs"
    assert bench.driver.records[0].temperature == pytest.approx(31.0)
    assert bench.driver.records[0].voltage == pytest.approx(48.0)
    assert not any(record.errors for record in bench.driver.records)


def test_no_time_is_lost_with_answers_that_are(bench: Bench) -> None:
    everybody = frozenset(unit.id for unit in TABLE.controllers)
    bench.exchange(OFFSET)
    bench.exchange(OFFSET, but=everybody)
    bench.exchange(OFFSET, but=everybody)
    assert bench.driver.elapsed == 0, "nobody has said"
    bench.exchange(OFFSET, but=frozenset({1, 2}))
    assert bench.driver.elapsed == 3 * 4_000_000
    bench.exchange(OFFSET, but=everybody - {1})
    assert bench.driver.elapsed == 4 * 4_000_000


def test_what_was_not_answered_keeps_its_last_state_and_stamp(bench: Bench) -> None:
    first = bench.exchange(OFFSET)
    second = bench.exchange(OFFSET + 0.01, but=frozenset({2}))
    rows = [NAMES.index("l_hip_pitch"), NAMES.index("l_knee_pitch")]
    assert second.position[rows] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert (second.stamp[rows] == first.stamp[rows]).all() and second.position[0] == pytest.approx(0.01, abs=1e-6)


@pytest.mark.parametrize("period", [4000, 8000, 16000])
def test_an_encoder_that_jumps_is_not_accepted_and_its_joint_held_by_what_it_says(bench: Bench, period: int) -> None:
    bench.period = period
    knee = NAMES.index("l_knee_pitch")
    bench.exchange(OFFSET)
    jumped = OFFSET.copy()
    jumped[knee] += 0.5
    for attempt in range(JUMPS_TO_FAULT + 2):
        measured = bench.exchange(jumped)
        assert measured.position[knee] == pytest.approx(0.0, abs=1e-6), attempt
    (unit_fault,) = bench.driver.unit_faults
    assert (unit_fault.unit, unit_fault.fault) == ("2", Fault.ENCODER) and "l_knee_pitch" in unit_fault.detail
    bench.driver.command = command(JointMode.FORCE)
    bench.driver._send_command()
    told = bench.commands()
    assert told[2]["mode"][1] == JointMode.POSITION
    assert told[2]["axis"][1]["position"] == pytest.approx(jumped[knee], abs=1e-6)
    assert told[2]["axis"][1]["effort"] == 0.0
    assert told[2]["mode"][0] == JointMode.FORCE, "its other axis goes on"
    bench.exchange(OFFSET)
    assert bench.driver.unit_faults, "once it has jumped, it is believed no more"


def test_an_encoder_that_is_back_after_a_wrong_state_is_accepted(bench: Bench) -> None:
    bench.exchange(OFFSET)
    bench.exchange(OFFSET + 0.5)
    measured = bench.exchange(OFFSET + 0.02)
    assert measured.position == pytest.approx(0.02, abs=1e-6) and not bench.driver.unit_faults


def test_one_wild_position_is_skipped(bench: Bench) -> None:
    bench.exchange(OFFSET)
    wild = OFFSET.copy()
    wild[0] = 3.0
    bench.exchange(wild)
    measured = bench.exchange(OFFSET)
    assert measured.position[0] == pytest.approx(0.0, abs=1e-6)
    assert not bench.driver.unit_faults and bench.driver.records[0].errors == 1


def test_a_controller_without_power_is_switched_on_again_only_where_that_moves_nothing(bench: Bench) -> None:
    bench.driver._enabled = True
    bench.exchange(OFFSET)
    for _ in range(2):
        bench.exchange(OFFSET, status=0)
    assert {unit_fault.fault for unit_fault in bench.driver.unit_faults} == {Fault.DISABLED}
    asked = [unit.identified for unit in bench.driver._controllers.values()]
    assert not any(asked), "who they are is asked again first"
    for unit in bench.driver._controllers.values():
        unit.identified = True
    far = command(JointMode.POSITION)
    bench.driver.command = far
    bench.driver._attend()
    requests = [frame for frame in bench.far.receive(0.0) if frame.identifier & can_frames.KIND == can_frames.REQUEST]
    assert {frame.identifier & can_frames.UNIT for frame in requests} == set(), "their set-points are far away"
    bench.driver.command = command(JointMode.OFF)
    bench.driver._attend()
    requests = [frame for frame in bench.far.receive(0.0) if frame.identifier & can_frames.KIND == can_frames.REQUEST]
    assert {frame.identifier & can_frames.UNIT for frame in requests} == set(bench.driver._controllers)


@given(st.integers(1, 63), st.binary(min_size=2, max_size=60), st.data())
def test_a_frame_with_one_wrong_byte_is_rejected(unit: int, content: bytes, data: st.DataObject) -> None:
    frame = bytearray(protect(can_frames.STATE + unit, content))
    assert is_valid(can_frames.STATE + unit, frame)
    place = data.draw(st.integers(0, len(frame) - 1))
    frame[place] ^= data.draw(st.integers(1, 255))
    assert not is_valid(can_frames.STATE + unit, frame)


def test_frames_have_lengths_that_can_fd_knows() -> None:
    known = {*range(9), 12, 16, 20, 24, 32, 48, 64}
    controller = can_frames.CONTROLLER_STATE.size + 2
    sensor = can_frames.SENSOR_STATE.size + 2
    assert (controller, sensor) == (can_frames.CONTROLLER_STATE_LENGTH, can_frames.SENSOR_STATE_LENGTH)
    assert {controller, sensor, can_frames.COMMAND_LENGTH, can_frames.REPLY_LENGTH} <= known
