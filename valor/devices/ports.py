"""Ports of devices: CAN buses by number, serial ports by the device's name.

The instance's settings may specify real ports: ``can0: socketcan:can0``, ``imu: /dev/ttyACM0``. Otherwise a CAN bus is
sockets of this computer (``EmulatedBus``), a serial port the socket ``ports/<device>`` in the instance's folder.
"""

import contextlib
import select
import socket
import struct
import time
from collections.abc import Iterable
from pathlib import Path

import can
import serial

from valor.common.errors import ConfigurationError
from valor.common.instance import Instance, Settings
from valor.devices.can_frames import KIND, TO_MASTER, TO_UNITS, Frame

_BUSES = 8
_ENDS = 3  # of an emulated bus, on each side
_RETRY = 0.05  # from a try to send to an end that nobody has to the next [s]
_LARGEST = 4096  # datagram [B]
_HEADER = struct.Struct("<HB")  # identifier and length of a frame in a datagram


class EmulatedBus:
    """One end of a bus on this computer, the master's or a unit's: a socket, which hears only the other side."""

    def __init__(self, name: str, master: bool) -> None:
        """``name``: of the bus. Raises OSError: its side has ``_ENDS`` ends already."""
        own, others = ([f"\0{name}/{side}/{k}" for k in range(_ENDS)] for side in (master, not master))
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self._others = dict.fromkeys(others, 0.0)  # end → when it is tried again, as nobody was there [monotonic s]
        for end in own:
            with contextlib.suppress(OSError):
                self._socket.bind(end)
                break
        else:
            raise OSError(f"all {_ENDS} ends are in use")
        self.fileno, self.close = self._socket.fileno, self._socket.close

    def send(self, frames: Iterable[Frame]) -> None:
        """Send frames in one datagram."""
        data = b"".join(_HEADER.pack(identifier, len(content)) + content for identifier, content in frames)
        now = time.monotonic()
        for other, again in self._others.items():
            if now >= again:
                try:
                    self._socket.sendto(data, other)
                except ConnectionRefusedError:
                    self._others[other] = now + _RETRY
                except BlockingIOError:
                    pass  # it does not listen

    def receive(self, timeout: float) -> list[Frame]:
        """All received frames; waits for the first one [s]."""
        if timeout:
            select.select((self._socket,), (), (), timeout)
        frames = []
        with contextlib.suppress(BlockingIOError):
            while True:
                data, at = self._socket.recv(_LARGEST), 0
                while at + _HEADER.size <= len(data):
                    identifier, length = _HEADER.unpack_from(data, at)
                    at += _HEADER.size + length
                    frames.append(Frame(identifier, data[at - length : at]))
        return frames


class RealBus:
    """A bus of ``python-can``; its errors are ``can.CanError``."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self.fileno, self.close = bus.fileno, bus.shutdown

    def send(self, frames: Iterable[Frame]) -> None:
        for identifier, data in frames:
            fd = len(data) > 8
            self._bus.send(
                can.Message(arbitration_id=identifier, data=data, is_extended_id=False, is_fd=fd, bitrate_switch=fd)
            )

    def receive(self, timeout: float) -> list[Frame]:
        frames: list[Frame] = []
        while (message := self._bus.recv(0.0 if frames else timeout)) is not None:
            frames.append(Frame(message.arbitration_id, bytes(message.data)))
        return frames


CanBus = EmulatedBus | RealBus


def serial_port(instance: Instance, settings: Settings, device: str) -> Path:
    """Serial port (or socket) of a device."""
    return Path(settings.ports.get(device) or instance.ports / device)


class EmulatedLine:
    """A serial line to an emulator; as ``serial.Serial``, but a read returns the first bytes that are received."""

    def __init__(self, path: Path, timeout: float) -> None:
        """``timeout``: of a read [s]. Raises OSError: no emulator listens."""
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.connect(str(path))
        except OSError:
            self._socket.close()
            raise
        self._timeout = timeout
        self._socket.setblocking(False)
        self.fileno, self.close = self._socket.fileno, self._socket.close

    def read(self, size: int) -> bytes:
        with contextlib.suppress(BlockingIOError):
            if self._timeout:
                select.select((self._socket,), (), (), self._timeout)
            if not (data := self._socket.recv(size)):
                raise serial.SerialException("the emulator has unplugged it")
            return data
        return b""

    def write(self, data: Iterable[int]) -> int:
        return self._socket.send(bytes(data))

    def reset_input_buffer(self) -> None:
        with contextlib.suppress(OSError):
            while self._socket.recv(_LARGEST):
                pass


def open_serial(path: Path, baud_rate: int, timeout: float) -> serial.Serial | EmulatedLine:
    """Open a serial port; ``timeout``: of a read [s]. Raises OSError: it cannot be opened, or is open already."""
    if path.is_socket():
        return EmulatedLine(path, timeout)
    return serial.Serial(str(path), baud_rate, timeout=timeout, write_timeout=0.1, exclusive=True)


def open_can(settings: Settings, bus: int, master: bool, data_bit_rate: int = 5_000_000) -> CanBus:
    """Open a CAN FD bus to receive only what units send, or only what the master sends.

    ``data_bit_rate``: on a real bus [bit/s]. Raises ConfigurationError: the bus cannot be opened.
    """
    if not 0 <= bus < _BUSES:
        raise ConfigurationError(f"CAN bus {bus}: expected 0 to {_BUSES - 1}")
    name = f"can{bus}"
    try:
        if not (port := settings.ports.get(name)):
            return EmulatedBus(f"valor/{settings.block}/{name}", master)
        interface, _, channel = port.partition(":")
        filters: can.typechecking.CanFilters = [
            {"can_id": kind, "can_mask": KIND, "extended": False} for kind in (TO_MASTER if master else TO_UNITS)
        ]
        return RealBus(
            can.Bus(interface=interface, channel=channel, can_filters=filters, fd=True, data_bitrate=data_bit_rate)
        )
    except (can.CanError, can.CanInterfaceNotImplementedError, OSError, ValueError) as error:
        raise ConfigurationError(f"port {name}: cannot be opened: {' '.join(str(error).split())}") from None
