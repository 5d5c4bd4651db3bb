"""Dynamixel servos on a serial port, spoken to with ``dynamixel-sdk``.

The SDK's own port never waits: its ``rxPacket`` turns round and round until a packet is there, and takes a whole core
from the control loop for it. ``WaitingPort`` reads with pyserial's time-out instead, so that a cycle sleeps while the
servos answer. ``GroupSyncRead`` gives up at the first servo that is missing; ``StatusReader`` takes the answers of
those that are there, whichever they are.
"""

from __future__ import annotations

import termios
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
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

from valor.devices.dynamixel import Item

ANSWER_TIME = 40.0  # that a servo has for the answer to a single request, besides the line's own [ms]
CYCLE_TIME = 7.0  # that all servos have together for a cycle's answers, likewise [ms]
TRIES = 3  # of a single request
QUIET = 0.03  # on the line, before a request is made again [s]
READ_TIME = 0.003  # that one read waits [s]
STATUS_OVERHEAD = 11  # bytes of a status frame besides its parameters
_ID, _ERROR, _PARAMETERS = 4, 8, 9
ALERT = 0x80


class DynamixelError(Exception):
    """The bus or a servo does not do what it was asked for."""


class WaitingPort(PortHandler):  # type: ignore[misc]
    """The SDK's port, reading with a time-out."""

    received = 0

    def setupPort(self, cflag_baud: int) -> bool:  # noqa: N802
        """Open the port; called by ``openPort``."""
        self.ser = serial.Serial(self.port_name, cflag_baud, timeout=READ_TIME, write_timeout=0.1, exclusive=True)
        self.is_open = True
        self.ser.reset_input_buffer()
        self.tx_time_per_byte = 10e3 / cflag_baud
        return True

    def clearPort(self) -> None:  # noqa: N802
        """Forget what came unasked; on a port that is gone, say so as pyserial does elsewhere."""
        try:
            self.ser.reset_input_buffer()
        except termios.error as error:
            raise serial.SerialException(f"{self.port_name}: {error.args[-1]}") from None

    def readPort(self, length: int) -> bytes:  # noqa: N802
        """Bytes that come in time, and how many have come since ``received`` was set to 0."""
        data: bytes = self.ser.read(length)
        self.received += len(data)
        return data

    def setPacketTimeout(self, packet_length: int) -> None:  # noqa: N802
        """When the SDK gives up waiting for a packet of that length."""
        self.setPacketTimeoutMillis(self.tx_time_per_byte * packet_length + ANSWER_TIME)


@dataclass(frozen=True)
class Answer:
    """A servo's status frame."""

    data: bytes
    error: int  # of the servo: 0, or its number; without the alert bit
    alert: bool  # its hardware_error is not 0


class StatusReader(GroupSyncRead):  # type: ignore[misc]
    """Reads the same block of several servos at once, and takes what answers come.

    Attributes:
        corrupt: cycles with as many bytes as an answer more than the answers had.
    """

    def __init__(self, port: WaitingPort, packets: Protocol2PacketHandler, block: Item) -> None:
        super().__init__(port, packets, block.address, block.size)
        self.corrupt = 0

    def read(self) -> dict[int, Answer]:
        """The answers, by servo; those that are missing did not come in time.

        Raises:
            DynamixelError: the request could not be sent.
        """
        wanted = len(self.data_dict)
        if not wanted:
            return {}
        if (result := self.txPacket()) != COMM_SUCCESS:
            raise DynamixelError(self.ph.getTxRxResult(result))
        line_time = self.port.tx_time_per_byte * wanted * (STATUS_OVERHEAD + self.data_length)
        self.port.setPacketTimeoutMillis(line_time + CYCLE_TIME)
        self.port.received = 0
        answers: dict[int, Answer] = {}
        place_of = {servo: place for place, servo in enumerate(self.data_dict)}
        place = 0  # of the newest answer
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
                    before, place = place, place_of[frame[_ID]]
                    if place < before:  # servos answer in their order: what came before it answers an earlier request
                        answers.clear()
                    answers[frame[_ID]] = answer
        finally:
            self.port.is_using = False
        # The SDK says nothing of bytes that it skips.
        self.corrupt += self.port.received >= (len(answers) + 1) * (STATUS_OVERHEAD + self.data_length)
        return answers


class DynamixelPort:
    """A bus of servos: items of control tables, read and written.

    All methods raise ``DynamixelError`` with servo and reason, and ``serial.SerialException`` when the port is
    gone.
    """

    def __init__(self, path: str, baud_rate: int) -> None:
        self._port = WaitingPort(path)
        if not self._port.setBaudRate(baud_rate):
            raise DynamixelError(f"{path}: baud rate {baud_rate}: not one that the servos know")
        self._packets = Protocol2PacketHandler()

    def ping(self, servo: int) -> tuple[int, int]:
        """Model number and firmware."""
        number, result, _ = self._again(lambda: self._packets.ping(self._port, servo))
        self._check(servo, "ping", result, 0)
        return number, self.read(servo, Item(6, 1))

    def read(self, servo: int, item: Item) -> int:
        """One number."""
        data, result, error = self._again(lambda: self._read(servo, item))
        self._check(servo, f"read of {item.address}", result, error)
        return number_of(bytes(data), item, item.address)

    def _read(self, servo: int, item: Item) -> tuple[bytes, int, int]:
        """Data, result and error of one request.

        The SDK takes any answer of the servo for the one to its request, and the checksum for data where that is
        shorter: what answers an earlier request, too late, must not be a number.
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
        """One number, acknowledged by the servo."""
        data = list(bytes_of(value, item))
        _, result, error = self._again(
            lambda: (None, *self._packets.writeTxRx(self._port, servo, item.address, item.size, data))
        )
        self._check(servo, f"write of {item.address}", result, error)

    def reboot(self, servo: int) -> None:
        """Start a servo anew, which forgets its errors."""
        result, _ = self._packets.reboot(self._port, servo)
        self._check(servo, "reboot", result, 0)

    def reader(self, block: Item, servos: Iterable[int]) -> StatusReader:
        """A reader of one block of several servos; ``addParam`` and ``removeParam`` change which."""
        reader = StatusReader(self._port, self._packets, block)
        for servo in servos:
            reader.addParam(servo)
        return reader

    def write_all(self, item: Item, values: dict[int, int]) -> None:
        """The same item of several servos in one frame, which none acknowledges."""
        group = GroupSyncWrite(self._port, self._packets, item.address, item.size)
        for servo, value in values.items():
            group.addParam(servo, list(bytes_of(value, item)))
        if values and (result := group.txPacket()) != COMM_SUCCESS:
            raise DynamixelError(self._packets.getTxRxResult(result))

    def close(self) -> None:
        """Give the port back."""
        self._port.closePort()

    def _again(self, request: Callable[[], tuple[Any, int, int]]) -> tuple[Any, int, int]:
        """Make a request until there is an answer, or enough of it: answer, result, error."""
        answer = self._asked(request)
        for _ in range(TRIES - 1):
            if answer[1] == COMM_SUCCESS:
                break
            self._let_pass()
            answer = self._asked(request)
            if answer[1] == COMM_SUCCESS:
                self._let_pass()  # it may have been to the request before
        return answer

    def _asked(self, request: Callable[[], tuple[Any, int, int]]) -> tuple[Any, int, int]:
        """Make a request; one that the line does not take in time, as on a busy computer, has no answer."""
        try:
            return request()
        except serial.SerialTimeoutException:
            self._port.is_using = False  # as the SDK leaves it only when it has sent
            return None, COMM_TX_FAIL, 0

    def _let_pass(self) -> None:
        """Let answers pass that come too late: answers do not say to what, and would be taken for that to the next."""
        quiet = time.monotonic() + QUIET
        while time.monotonic() < quiet:
            if self._port.ser.read(256):
                quiet = time.monotonic() + QUIET

    def _check(self, servo: int, what: str, result: int, error: int) -> None:
        if result == COMM_RX_TIMEOUT:
            raise DynamixelError(f"servo {servo}: no answer to a {what}")
        if result == COMM_RX_CORRUPT:
            raise DynamixelError(f"servo {servo}: answer to a {what} with a wrong checksum")
        if result != COMM_SUCCESS:
            raise DynamixelError(f"servo {servo}: {what}: {self._packets.getTxRxResult(result)}")
        if error & ~ALERT:
            raise DynamixelError(f"servo {servo}: refused a {what}: {self._packets.getRxPacketError(error & ~ALERT)}")


def bytes_of(value: int, item: Item) -> bytes:
    """A number as it stands in the control table."""
    return (value & ((1 << 8 * item.size) - 1)).to_bytes(item.size, "little")


def number_of(block: bytes, item: Item, start: int) -> int:
    """A number of a block that was read from address ``start``."""
    place = item.address - start
    return int.from_bytes(block[place : place + item.size], "little", signed=item.signed)


def _answer(frame: list[int]) -> Answer:
    """The SDK takes the stuffing out and corrects the length, which then counts without it."""
    end = 7 + (frame[5] | frame[6] << 8) - 2
    return Answer(bytes(frame[_PARAMETERS:end]), frame[_ERROR] & ~ALERT, bool(frame[_ERROR] & ALERT))
