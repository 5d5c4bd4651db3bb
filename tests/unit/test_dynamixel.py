"""Dynamixel protocol 2.0: the vendor's SDK on one end of a pseudo-terminal, the emulated servos on the other."""

from __future__ import annotations

import contextlib
import os
import select
import threading
import time
import tty
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
import serial
from dynamixel_sdk import Protocol2PacketHandler
from hypothesis import given
from hypothesis import strategies as st

from harness.waiting import wait_until
from valor.comms_manager.hardware.dynamixel_port import Answer, DynamixelError, DynamixelPort, StatusReader, number_of
from valor.device_emulators.dynamixel_bus import DynamixelBus, Status, crc16, encode, stuffed, unstuffed
from valor.device_emulators.dynamixel_servo import Servo
from valor.device_emulators.emulator import EmulatedFault, FaultSwitches
from valor.device_emulators.serial_port import SerialPort, line
from valor.devices.dynamixel import MODELS, P_SERIES, X_SERIES, ControlTable, HardwareError, Item, OperatingMode

TABLES = (X_SERIES, P_SERIES)


class Bus:
    """Servos at the end of a port, with a thread for them."""

    def __init__(self, folder: Path, *models: str) -> None:
        self.port = SerialPort(folder / "dynamixel")
        self.servos = [Servo(i + 1, MODELS[model], 46) for i, model in enumerate(models)]
        self.bus = DynamixelBus(self.servos)
        self.faults = FaultSwitches(tuple(str(servo.id) for servo in self.servos))
        self.line = line(self.port, self.faults)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(0.0005):
            now = time.monotonic()
            for status in self.bus.receive(self.port.read()):
                self.line.send(str(status.servo), status.frame, now)
            self.line.flush(now)

    def inject(self, fault: str, *servos: int) -> None:
        for servo in servos:
            self.faults.inject(str(servo), EmulatedFault(fault))

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.port.close()


def all_answer(port: DynamixelPort, reader: StatusReader) -> dict[int, Answer]:
    """An answer of each; a busy computer may give the servos no turn within a cycle, and they then answer too late."""

    def asked() -> dict[int, Answer]:
        answers = reader.read()
        if len(answers) == len(reader.data_dict):
            return answers
        port._let_pass()
        return {}

    return wait_until(asked, 10, "an answer of each")


@pytest.fixture
def bus(tmp_path: Path) -> Iterator[Bus]:
    bus = Bus(tmp_path, "XM540-W270", "XM430-W350", "MX-64")
    yield bus
    bus.close()


@pytest.fixture
def port(bus: Bus) -> Iterator[DynamixelPort]:
    port = DynamixelPort(str(bus.port.link), 3000000)
    yield port
    port.close()


@given(st.binary(max_size=200))
def test_crc_is_the_sdks(data: bytes) -> None:
    assert crc16(data) == Protocol2PacketHandler().updateCRC(0, list(data), len(data))


@given(st.lists(st.sampled_from([b"\xff", b"\xfd", b"\xff\xff\xfd", b"\x00", b"\x07"]), max_size=40).map(b"".join))
def test_stuffing_hides_every_header_and_comes_out_again(body: bytes) -> None:
    assert b"\xff\xff\xfd\x00" not in stuffed(body) + b"\xaa"
    assert unstuffed(stuffed(body)) == body


@given(st.lists(st.binary(max_size=20), max_size=3).map(b"".join), st.integers(0, 40))
def test_commands_are_found_among_garbage_and_pieces(garbage: bytes, cut: int) -> None:
    servo = Servo(7, MODELS["MX-28"], 46)
    bus = DynamixelBus([servo])
    line = garbage + encode(7, 0x01, b"")
    answers = bus.receive(line[:cut]) + bus.receive(line[cut:]) + bus.receive(bytes(1100))
    assert [answer.frame for answer in answers] == [encode(7, 0x55, bytes((0, 30, 0, 46)))]


@given(st.integers(0, 200), st.integers(1, 255))
def test_a_frame_with_a_wrong_byte_moves_nothing(place: int, flip: int) -> None:
    servo = Servo(1, MODELS["XM430-W350"], 46)
    frame = bytearray(encode(1, 0x03, X_SERIES.torque_enable.address.to_bytes(2, "little") + b"\x01"))
    frame[place % len(frame)] ^= flip
    DynamixelBus([servo]).receive(bytes(frame))
    assert not servo.torque


@pytest.mark.parametrize("table", TABLES, ids=["X", "P"])
def test_items_of_a_table_do_not_overlap(table: ControlTable) -> None:
    items = sorted(item for item in (*vars(table).values(), *vars(ControlTable).values()) if isinstance(item, Item))
    assert all(one.address + one.size <= other.address for one, other in pairwise(items))
    assert items[-1].address + items[-1].size == table.size


def test_servos_are_found(port: DynamixelPort) -> None:
    assert [port.ping(servo) for servo in (1, 2, 3)] == [(1120, 46), (1020, 46), (311, 46)]
    with pytest.raises(DynamixelError, match="servo 4: no answer to a ping"):
        port.ping(4)


def test_items_are_written_and_read(bus: Bus, port: DynamixelPort) -> None:
    servo = bus.servos[1]
    servo.feel(2100.0, 0.5, -0.3, 12.345)
    port.write(2, X_SERIES.torque_enable, 1)
    port.write(2, X_SERIES.goal_position, 3000)
    assert servo.torque
    assert servo.goal_position == 3000
    assert port.read(2, X_SERIES.present_position) == 2100
    assert port.read(2, X_SERIES.present_velocity) * servo.model.velocity_unit == pytest.approx(0.5, abs=0.013)
    assert port.read(2, X_SERIES.present_current) < 0
    assert port.read(2, X_SERIES.realtime_tick) == 12345


@pytest.mark.parametrize("value", [-1, 0x00FDFFFF, -768])
def test_numbers_that_look_like_a_header_pass(bus: Bus, port: DynamixelPort, value: int) -> None:
    """0xFF 0xFF 0xFD within the data is stuffed by one end and taken out by the other."""
    port.write(1, X_SERIES.operating_mode, OperatingMode.EXTENDED_POSITION)
    port.write(1, X_SERIES.goal_position, value)
    assert bus.servos[0].goal_position == value
    bus.servos[0].feel(value, 0.0, 0.0, 0.0)
    assert port.read(1, X_SERIES.present_position) == value
    answers = all_answer(port, port.reader(X_SERIES.feedback, (1, 2, 3)))
    block = X_SERIES.feedback.address
    assert number_of(answers[1].data, X_SERIES.present_position, block) == value


@pytest.mark.parametrize(
    ("item", "value", "reason"),
    [
        (X_SERIES.goal_position, 4096, "range"),
        (X_SERIES.torque_enable, 2, "range"),
        (X_SERIES.present_position, 5, "not available"),
    ],
)
def test_a_refusal_names_servo_and_reason(port: DynamixelPort, item: object, value: int, reason: str) -> None:
    with pytest.raises(DynamixelError, match=f"(?i)servo 3: refused a write.*{reason}"):
        port.write(3, item, value)  # type: ignore[arg-type]


def test_the_operating_mode_is_locked_while_the_torque_is_on(port: DynamixelPort) -> None:
    port.write(3, X_SERIES.torque_enable, 1)
    with pytest.raises(DynamixelError, match="not available"):
        port.write(3, X_SERIES.operating_mode, OperatingMode.VELOCITY)


def test_one_frame_writes_several_and_one_reads_them(bus: Bus, port: DynamixelPort) -> None:
    port.write_all(X_SERIES.goal_position, {1: 1000, 3: 3000})
    all_answer(port, port.reader(X_SERIES.feedback, (1, 2, 3)))
    assert [servo.goal_position for servo in bus.servos] == [1000, 0, 3000]


@pytest.mark.parametrize("fault", ["silent", "bad_checksum", "garbage", "late"])
def test_a_sick_servo_does_not_silence_the_others(bus: Bus, port: DynamixelPort, fault: str) -> None:
    reader = port.reader(X_SERIES.feedback, (1, 2, 3))
    bus.inject(fault, 1)

    def others_answer() -> bool:
        answers = reader.read()
        assert fault == "late" or 1 not in answers
        return {2, 3} <= set(answers)

    wait_until(others_answer, 10, "the others answer")
    bus.faults.clear()
    all_answer(port, reader)


def test_answers_that_come_twice_are_taken_once(bus: Bus, port: DynamixelPort) -> None:
    bus.inject("duplicate", 1, 2, 3)
    reader = port.reader(X_SERIES.feedback, (1, 2, 3))
    for turn in range(20):
        bus.servos[0].feel(turn, 0.0, 0.0, 0.0)
        answers = all_answer(port, reader)
        assert number_of(answers[1].data, X_SERIES.present_position, X_SERIES.feedback.address) == turn


def test_what_answers_the_reading_before_is_no_answer_to_this_one(bus: Bus, port: DynamixelPort) -> None:
    receive, late = bus.bus.receive, list[Status]()

    def receive_and_repeat_the_last_later(data: bytes) -> list[Status]:
        if not (answers := receive(data)):
            return []
        said = [*late, *answers]
        late[:] = answers[-1:]
        return said

    bus.bus.receive = receive_and_repeat_the_last_later  # type: ignore[method-assign]
    reader = port.reader(X_SERIES.feedback, (1, 2, 3))
    for turn in range(5):
        for servo in bus.servos:
            servo.feel(turn, 0.0, 0.0, 0.0)
        answers = all_answer(port, reader)
        for answer in answers.values():
            assert number_of(answer.data, X_SERIES.present_position, X_SERIES.feedback.address) == turn


def test_a_hot_servo_lets_go_raises_the_alarm_and_comes_back_by_a_reboot(bus: Bus, port: DynamixelPort) -> None:
    hot = bus.servos[0]
    port.write(1, X_SERIES.torque_enable, 1)
    hot.temperature = 85.0
    hot.feel(0.0, 0.0, 0.0, 0.0)
    answers = all_answer(port, port.reader(X_SERIES.feedback, (1, 2)))
    assert (answers[1].alert, answers[2].alert) == (True, False)
    assert port.read(1, X_SERIES.hardware_error) == HardwareError.OVERHEATING
    assert not hot.torque
    with pytest.raises(DynamixelError, match="not available"):
        port.write(1, X_SERIES.torque_enable, 1)
    hot.temperature = 50.0
    port.reboot(1)
    port.write(1, X_SERIES.torque_enable, 1)
    assert hot.torque


def test_too_little_voltage_is_an_alarm_that_keeps_the_torque_on(bus: Bus, port: DynamixelPort) -> None:
    port.write(1, X_SERIES.torque_enable, 1)
    bus.servos[0].voltage = 8.0
    bus.servos[0].feel(0.0, 0.0, 0.0, 0.0)
    assert port.read(1, X_SERIES.hardware_error) == HardwareError.INPUT_VOLTAGE
    assert bus.servos[0].torque


def test_an_unplugged_port_is_seen_and_found_again(bus: Bus, port: DynamixelPort) -> None:
    reader = port.reader(X_SERIES.feedback, (1, 2, 3))
    all_answer(port, reader)
    bus.port.unplug()
    with pytest.raises(serial.SerialException):
        reader.read()
    with pytest.raises(serial.SerialException):
        DynamixelPort(str(bus.port.link), 3000000)
    bus.port.plug()
    again = DynamixelPort(str(bus.port.link), 3000000)
    assert again.ping(2) == (1020, 46)
    again.close()


def test_waiting_for_servos_leaves_the_processor_to_others(bus: Bus, port: DynamixelPort) -> None:
    """The SDK's own port turns all the while it waits; a silent bus would cost a core."""
    bus.inject("silent", 1, 2, 3)
    reader = port.reader(X_SERIES.feedback, (1, 2, 3))
    began, used = time.monotonic(), time.thread_time()
    for _ in range(30):
        assert reader.read() == {}
    assert time.thread_time() - used < 0.5 * (time.monotonic() - began)


def test_the_late_answer_to_an_earlier_request_is_no_number(bus: Bus, port: DynamixelPort) -> None:
    """An answer of one byte that comes while four are awaited, from the same servo."""
    bus.servos[0].feel(2100.0, 0.0, 0.0, 0.0)
    stale = encode(1, 0x55, bytes((0, 46)))
    for _ in range(10):
        late = threading.Timer(0.0005, lambda: bus.port.write(stale))
        late.start()
        assert port.read(1, X_SERIES.present_position) == 2100
        late.join()


def test_of_two_answers_to_a_request_made_again_the_second_is_none_to_the_next() -> None:
    """As of a servo, or an emulator, that was held up until it was asked again."""
    device, driver_end = os.openpty()
    tty.setraw(driver_end)
    port = DynamixelPort(os.ttyname(driver_end), 3000000)

    def answer() -> None:
        os.read(device, 256)
        os.read(device, 256)  # the same request, made again
        os.write(device, encode(1, 0x55, bytes((0, 1, 1, 0, 0))))
        time.sleep(0.005)  # on the line between the two
        os.write(device, encode(1, 0x55, bytes((0, 1, 1, 0, 0))))
        os.read(device, 256)
        os.write(device, encode(1, 0x55, bytes((0, 2, 2, 0, 0))))

    servo = threading.Thread(target=answer)
    servo.start()
    assert port.read(1, X_SERIES.goal_position) == 257
    assert port.read(1, X_SERIES.present_position) == 514
    servo.join()
    port.close()
    os.close(device)
    os.close(driver_end)


def test_a_line_that_takes_nothing_has_servos_that_do_not_answer() -> None:
    """As on a busy computer; once it takes something again, it is asked again."""
    device, driver_end = os.openpty()
    tty.setraw(driver_end)
    os.set_blocking(driver_end, False)
    os.set_blocking(device, False)
    port = DynamixelPort(os.ttyname(driver_end), 3000000)
    while select.select([], [driver_end], [], 0.2)[1]:  # the kernel passes on what it has, in its own time
        with contextlib.suppress(BlockingIOError):
            os.write(driver_end, bytes(1000))
    with pytest.raises(DynamixelError, match="servo 1: ping"):
        port.ping(1)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.read(device, 4096)
    with pytest.raises(DynamixelError, match="servo 1: no answer to a ping"):
        port.ping(1)
    port.close()
    os.close(device)
    os.close(driver_end)
