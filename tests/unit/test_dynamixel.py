"""Dynamixel protocol 2.0: the vendor's SDK on one end of a pseudo-terminal, the emulated servos on the other."""

from __future__ import annotations

import contextlib
import os
import select
import threading
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from harness.waiting import wait_until
from valor.comms_manager.hardware.dynamixel_port import Answer, DynamixelError, DynamixelPort, StatusReader, number_of
from valor.device_emulators.dynamixel import DynamixelBus, Servo, Status, encode
from valor.device_emulators.emulator import ALL_FAULTS, EmulatedFault, FaultSwitches, FaultyLine
from valor.device_emulators.serial_port import SerialPort
from valor.devices.dynamixel import MODELS, X_SERIES, OperatingMode


class Bus:
    def __init__(self, folder: Path, *models: str) -> None:
        self.port = SerialPort(folder / "dynamixel")
        self.servos = [Servo(i + 1, MODELS[model], 46) for i, model in enumerate(models)]
        self.bus = DynamixelBus(self.servos)
        self.faults = FaultSwitches({str(servo.id): ALL_FAULTS for servo in self.servos})
        self.line = FaultyLine(self.port.write, self.faults)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(0.0005):
            now = time.monotonic()
            for status in self.bus.receive(self.port.read()):
                self.line.send(str(status.servo), status.frame, now)
            self.line.flush(now)

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
        port._discard_late()
        return {}

    return wait_until(asked, 10, "an answer of each")


@pytest.fixture
def bus(tmp_path: Path) -> Iterator[Bus]:
    bus = Bus(tmp_path, "XM540-W270", "XM430-W350", "MX-64")
    yield bus
    bus.close()


@pytest.fixture
def port(bus: Bus) -> Iterator[DynamixelPort]:
    port = DynamixelPort(str(bus.port.path), 3000000)
    yield port
    port.close()


def test_items_are_written_and_read(bus: Bus, port: DynamixelPort) -> None:
    servo = bus.servos[1]
    servo.measure(2100.0, 0.5, -0.3, 12.345)
    port.write(2, X_SERIES.torque_enable, 1)
    port.write(2, X_SERIES.goal_position, 3000)
    assert servo.torque and servo.goal_position == 3000
    assert port.read(2, X_SERIES.present_position) == 2100
    assert port.read(2, X_SERIES.present_velocity) * servo.model.velocity_unit == pytest.approx(0.5, abs=0.013)
    assert port.read(2, X_SERIES.present_effort) < 0 and port.read(2, X_SERIES.realtime_tick) == 12345
    port.write_all(X_SERIES.goal_position, {1: 1000, 3: 4000})
    all_answer(port, port.reader(X_SERIES.feedback, (1, 2, 3)))
    assert [each.goal_position for each in bus.servos] == [1000, 3000, 4000]


@pytest.mark.parametrize("value", [-1, 0x00FDFFFF, -768])
def test_numbers_that_look_like_a_header_pass(bus: Bus, port: DynamixelPort, value: int) -> None:
    """0xFF 0xFF 0xFD within the data is stuffed by one end and taken out by the other."""
    port.write(1, X_SERIES.operating_mode, OperatingMode.EXTENDED_POSITION)
    port.write(1, X_SERIES.goal_position, value)
    assert bus.servos[0].goal_position == value
    bus.servos[0].measure(value, 0.0, 0.0, 0.0)
    assert port.read(1, X_SERIES.present_position) == value
    answers = all_answer(port, port.reader(X_SERIES.feedback, (1, 2, 3)))
    block = X_SERIES.feedback.address
    assert number_of(answers[1].data, X_SERIES.present_position, block) == value


def test_a_rejection_names_servo_and_reason(port: DynamixelPort) -> None:
    port.write(3, X_SERIES.torque_enable, 1)
    for item, value, reason in (
        (X_SERIES.goal_position, 4096, "range"),
        (X_SERIES.torque_enable, 2, "range"),
        (X_SERIES.present_position, 5, "not available"),
        (X_SERIES.operating_mode, OperatingMode.VELOCITY, "not available"),  # locked while the torque is on
    ):
        with pytest.raises(DynamixelError, match=f"(?i)servo 3: rejected a write.*{reason}"):
            port.write(3, item, value)


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
            servo.measure(turn, 0.0, 0.0, 0.0)
        answers = all_answer(port, reader)
        for answer in answers.values():
            assert number_of(answer.data, X_SERIES.present_position, X_SERIES.feedback.address) == turn


def test_waiting_for_servos_leaves_the_processor_to_others(bus: Bus, port: DynamixelPort) -> None:
    """The SDK's own port turns all the while it waits; a silent bus would cost a core."""
    for servo in bus.servos:
        bus.faults.inject(str(servo.id), EmulatedFault.SILENT)
    reader = port.reader(X_SERIES.feedback, (1, 2, 3))
    began, used = time.monotonic(), time.thread_time()
    for _ in range(30):
        assert reader.read() == {}
    assert time.thread_time() - used < 0.5 * (time.monotonic() - began)


def test_the_late_answer_to_an_earlier_request_is_no_number(bus: Bus, port: DynamixelPort) -> None:
    """An answer of one byte that comes while four are awaited, from the same servo."""
    bus.servos[0].measure(2100.0, 0.0, 0.0, 0.0)
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
    assert port.read(1, X_SERIES.goal_position) == 257 and port.read(1, X_SERIES.present_position) == 514
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
    with pytest.raises(DynamixelError, match=r"servo 1: .* to a ping"):
        port.ping(1)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.read(device, 4096)
    with pytest.raises(DynamixelError, match="servo 1: no answer to a ping"):
        port.ping(1)
    port.close()
    os.close(device)
    os.close(driver_end)
