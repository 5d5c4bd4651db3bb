"""Dynamixel servos on a serial port, with ``dynamixel-sdk``.

The SDK's port polls without pause until a packet is complete, which costs the control loop a core; ``WaitingPort``
waits in pyserial's read. The SDK's ``GroupSyncRead`` stops at the first missing servo; ``StatusReader`` accepts the
responses of the others.
"""

import termios
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import serial
from dynamixel_sdk import (
    COMM_RX_CORRUPT,
    COMM_RX_TIMEOUT,
    COMM_SUCCESS,
    COMM_TX_FAIL,
    GroupSyncRead,
    GroupSyncWrite,
    PortHandler,
    Protocol2PacketHandler,
)

from valor.devices.dynamixel import ControlTable, Item
from valor.devices.ports import open_serial

ANSWER_TIME = 40.0  # timeout of a single request, without transmission [ms]
CYCLE_TIME = 7.0  # timeout of all responses of a cycle, without transmission [ms]
TRIES = 3  # of a single request
QUIET = 0.03  # silence of the line before a request is repeated [s]
READ_TIME = 0.003  # timeout of one read [s]
STATUS_OVERHEAD = 11  # bytes of a status frame besides its parameters
_ID, _ERROR, _PARAMETERS = 4, 8, 9
ALERT = 0x80


class DynamixelError(Exception):
    """The bus or a servo does not execute a request."""


class WaitingPort(PortHandler):  # type: ignore[misc]
    """The SDK's port, with a timeout in each read."""

    received = 0

    def setupPort(self, cflag_baud: int) -> bool:  # noqa: N802
        self.ser = open_serial(Path(self.port_name), cflag_baud, READ_TIME)
        self.is_open = True
        self.ser.reset_input_buffer()
        self.tx_time_per_byte = 10e3 / cflag_baud
        return True

    def clearPort(self) -> None:  # noqa: N802
        """Discard received bytes; raises ``SerialException`` if the port is gone."""
        try:
            self.ser.reset_input_buffer()
        except termios.error as error:
            raise serial.SerialException(f"{self.port_name}: {error.args[-1]}") from None

    def readPort(self, length: int) -> bytes:  # noqa: N802
        data: bytes = self.ser.read(length)
        self.received += len(data)
        return data

    def setPacketTimeout(self, packet_length: int) -> None:  # noqa: N802
        self.setPacketTimeoutMillis(self.tx_time_per_byte * packet_length + ANSWER_TIME)


@dataclass(frozen=True)
class Answer:
    """A servo's status frame."""

    data: bytes
    error: int  # number, without the alert bit; 0: none
    alert: bool  # its hardware_error is not 0


class StatusReader(GroupSyncRead):  # type: ignore[misc]
    """Reads the same block of several servos at once."""

    def __init__(self, port: WaitingPort, packets: Protocol2PacketHandler, block: Item) -> None:
        super().__init__(port, packets, block.address, block.size)
        self.corrupt = 0  # number of cycles with enough bytes for a further response

    def read(self) -> dict[int, Answer]:
        """Responses by servo, of those that responded in time. Raises DynamixelError: the request could not be sent."""
        wanted = len(self.data_dict)
        if not wanted:
            return {}
        if (result := self.txPacket()) != COMM_SUCCESS:
            raise DynamixelError(self.ph.getTxRxResult(result))
        line_time = self.port.tx_time_per_byte * wanted * (STATUS_OVERHEAD + self.data_length)
        self.port.setPacketTimeoutMillis(line_time + CYCLE_TIME)
        self.port.received = 0
        answers: dict[int, Answer] = {}
        order = list(self.data_dict)
        latest = 0  # index of the latest response
        try:
            while len(answers) < wanted:
                frame, result = self.ph.rxPacket(self.port, False)
                if result == COMM_RX_TIMEOUT:
                    break
                if result != COMM_SUCCESS:
                    if self.port.isPacketTimeout():
                        break
                    continue
                answer = _answer(frame)
                if frame[_ID] in self.data_dict and len(answer.data) == self.data_length:
                    before, latest = latest, order.index(frame[_ID])
                    if latest < before:  # servos respond in order: the earlier frames answer an earlier request
                        answers.clear()
                    answers[frame[_ID]] = answer
        finally:
            self.port.is_using = False
        # The SDK does not report the bytes that it skips.
        self.corrupt += self.port.received >= (len(answers) + 1) * (STATUS_OVERHEAD + self.data_length)
        return answers


class DynamixelPort:
    """A bus of servos: reads and writes items of control tables.

    All methods raise ``DynamixelError`` with servo and reason, and ``serial.SerialException`` if the port is gone.
    """

    def __init__(self, path: str, baud_rate: int) -> None:
        self._port = WaitingPort(path)
        if not self._port.setBaudRate(baud_rate):
            raise DynamixelError(f"{path}: baud rate {baud_rate}: the servos do not support it")
        self._packets = Protocol2PacketHandler()

    def ping(self, servo: int) -> tuple[int, int]:
        """Model number and firmware."""
        number, result, _ = self._again(lambda: self._packets.ping(self._port, servo))
        self._check(servo, "ping", result, 0)
        return number, self.read(servo, ControlTable.firmware)

    def read(self, servo: int, item: Item) -> int:
        data, result, error = self._again(lambda: self._read(servo, item))
        self._check(servo, f"read of {item.address}", result, error)
        return number_of(bytes(data), item, item.address)

    def _read(self, servo: int, item: Item) -> tuple[bytes, int, int]:
        """Data, result and error of one request.

        The SDK accepts any response of the servo, also a late one to an earlier request, and reads its checksum as data
        if it is shorter: responses of another length are skipped here.
        """
        if (result := self._packets.readTx(self._port, servo, item.address, item.size)) != COMM_SUCCESS:
            return b"", result, 0
        while True:
            frame, result = self._packets.rxPacket(self._port, False)
            if result != COMM_SUCCESS:
                return b"", result, 0
            answer = _answer(frame)
            if frame[_ID] == servo and (answer.error or len(answer.data) == item.size):
                return answer.data, result, answer.error

    def write(self, servo: int, item: Item, value: int) -> None:
        """Write an item; the servo acknowledges it."""
        data = list(bytes_of(value, item))
        _, result, error = self._again(
            lambda: (None, *self._packets.writeTxRx(self._port, servo, item.address, item.size, data))
        )
        self._check(servo, f"write of {item.address}", result, error)

    def reboot(self, servo: int) -> None:
        """Restart a servo, which clears its errors."""
        result, _ = self._packets.reboot(self._port, servo)
        self._check(servo, "reboot", result, 0)

    def reader(self, block: Item, servos: Iterable[int]) -> StatusReader:
        """Reader of one block of several servos; ``removeParam`` excludes one."""
        reader = StatusReader(self._port, self._packets, block)
        for servo in servos:
            reader.addParam(servo)
        return reader

    def write_all(self, item: Item, values: dict[int, int]) -> None:
        """Write an item of several servos in one frame, without acknowledgment."""
        group = GroupSyncWrite(self._port, self._packets, item.address, item.size)
        for servo, value in values.items():
            group.addParam(servo, list(bytes_of(value, item)))
        if values and (result := group.txPacket()) != COMM_SUCCESS:
            raise DynamixelError(self._packets.getTxRxResult(result))

    def close(self) -> None:
        self._port.closePort()

    def _again(self, request: Callable[[], tuple[Any, int, int]]) -> tuple[Any, int, int]:
        """Repeat a request until there is a response, at most ``TRIES`` times; data, result, error."""
        answer = self._attempt(request)
        for _ in range(TRIES - 1):
            if answer[1] == COMM_SUCCESS:
                break
            self._discard_late()
            answer = self._attempt(request)
            if answer[1] == COMM_SUCCESS:
                self._discard_late()  # it may answer the first request: another one follows
        return answer

    def _attempt(self, request: Callable[[], tuple[Any, int, int]]) -> tuple[Any, int, int]:
        """Make a request; if the line does not accept it in time, it has no response."""
        try:
            return request()
        except serial.SerialTimeoutException:
            self._port.is_using = False  # the SDK clears it only after sending
            return None, COMM_TX_FAIL, 0

    def _discard_late(self) -> None:
        """Discard late responses, which would be accepted as responses to the next request."""
        quiet = time.monotonic() + QUIET
        while time.monotonic() < quiet:
            if self._port.ser.read(256):
                quiet = time.monotonic() + QUIET

    def _check(self, servo: int, what: str, result: int, error: int) -> None:
        if result != COMM_SUCCESS:
            known = {COMM_RX_TIMEOUT: "no answer", COMM_RX_CORRUPT: "answer with a wrong checksum"}
            reason = known.get(result) or self._packets.getTxRxResult(result)
            raise DynamixelError(f"servo {servo}: {reason} to a {what}")
        if error & ~ALERT:
            raise DynamixelError(f"servo {servo}: rejected a {what}: {self._packets.getRxPacketError(error & ~ALERT)}")


def bytes_of(value: int, item: Item) -> bytes:
    return (value & ((1 << 8 * item.size) - 1)).to_bytes(item.size, "little")


def number_of(block: bytes, item: Item, start: int) -> int:
    """Number in a block that starts at address ``start``."""
    offset = item.address - start
    return int.from_bytes(block[offset : offset + item.size], "little", signed=item.signed)


def _answer(frame: list[int]) -> Answer:
    # The SDK removes the stuffing, and reduces the length accordingly.
    end = 7 + (frame[5] | frame[6] << 8) - 2
    return Answer(bytes(frame[_PARAMETERS:end]), frame[_ERROR] & ~ALERT, bool(frame[_ERROR] & ALERT))
