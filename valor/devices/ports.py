"""Ports of devices: CAN buses by number, serial ports by the device's name.

The instance's settings may specify real ports: ``can0: socketcan:can0``, ``imu: /dev/ttyACM0``. Otherwise a CAN bus is
UDP multicast on a port of the instance, a serial port a pseudo-terminal linked to ``ports/<device>`` in its folder.
"""

import ctypes
import os
import socket
import struct
from collections.abc import Sequence
from pathlib import Path

import can

from valor.common.errors import ConfigurationError
from valor.common.instance import Instance, Settings

_FIRST_PORT = 5500  # UDP; eight ports for each of 101 ROS domains
_BUSES = 8

_SO_ATTACH_FILTER = 26
_UDP_HEADER = 8  # before the data that the filter receives [B]
_MAP, _MAP_OF_11 = _UDP_HEADER, 0x8B
_KEY, _KEY_OF_14 = _UDP_HEADER + 20, 0xAE  # of the second entry, arbitration_id
_NUMBER, _UINT8, _UINT16 = _UDP_HEADER + 35, 0xCC, 0xCD
# Classic BPF (linux/bpf_common.h).
_LOAD_BYTE, _LOAD_HALF, _AND, _EQUAL, _JUMP, _RETURN = 0x30, 0x28, 0x54, 0x15, 0x05, 0x06
_ALL, _NOTHING = 0xFFFFFFFF, 0


def attach_filter(file: int, kinds: Sequence[int], mask: int) -> None:
    """Let a bus' socket receive only identifiers of some ``kinds`` under the mask, so that others wake no thread.

    ``file``: descriptor of the socket. Raises OSError: the kernel rejects the filter.
    """
    program = _program(kinds, mask)
    code = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *each) for each in program))
    with socket.socket(fileno=os.dup(file)) as end:
        end.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, struct.pack("@HP", len(program), ctypes.addressof(code)))


def _program(kinds: Sequence[int], mask: int) -> list[tuple[int, int, int, int]]:
    """Instructions: code, jump distances if true and if false, constant."""
    count = len(kinds)
    take = 12 + count  # index of the instruction that accepts the frame
    return [
        (_LOAD_BYTE, 0, 0, _MAP),
        (_EQUAL, 0, take - 2, _MAP_OF_11),
        (_LOAD_BYTE, 0, 0, _KEY),
        (_EQUAL, 0, take - 4, _KEY_OF_14),
        (_LOAD_BYTE, 0, 0, _NUMBER),
        (_EQUAL, 3, 0, _UINT16),
        (_EQUAL, 0, take - 7, _UINT8),
        (_LOAD_BYTE, 0, 0, _NUMBER + 1),
        (_JUMP, 0, 0, 1),
        (_LOAD_HALF, 0, 0, _NUMBER + 1),
        (_AND, 0, 0, mask),
        *((_EQUAL, count - k, 0, kind) for k, kind in enumerate(kinds)),
        (_RETURN, 0, 0, _NOTHING),
        (_RETURN, 0, 0, _ALL),
    ]


def serial_port(instance: Instance, settings: Settings, device: str) -> Path:
    """Serial port (or socket) of a device."""
    return Path(settings.ports.get(device) or instance.ports / device)


def open_can(
    settings: Settings, bus: int, kinds: Sequence[int], mask: int, data_bit_rate: int = 5_000_000
) -> can.BusABC:
    """Open a CAN FD bus to receive only identifiers of some ``kinds`` under the mask, where the kernel can filter.

    ``data_bit_rate``: on a real bus [bit/s]. Raises ConfigurationError: the bus cannot be opened.
    """
    if not 0 <= bus < _BUSES:
        raise ConfigurationError(f"CAN bus {bus}: expected 0 to {_BUSES - 1}")
    name = f"can{bus}"
    try:
        if port := settings.ports.get(name):
            interface, _, channel = port.partition(":")
            filters: can.typechecking.CanFilters = [
                {"can_id": kind, "can_mask": mask, "extended": False} for kind in kinds
            ]
            return can.Bus(
                interface=interface, channel=channel, can_filters=filters, fd=True, data_bitrate=data_bit_rate
            )
        block = settings.block
        opened = can.Bus(
            interface="udp_multicast",
            channel=f"239.255.{block}.{bus}",
            port=_FIRST_PORT + _BUSES * block + bus,
            hop_limit=0,
            fd=True,
        )
        attach_filter(opened.fileno(), kinds, mask)
        return opened
    except (can.CanError, can.CanInterfaceNotImplementedError, OSError, ValueError) as error:
        raise ConfigurationError(f"port {name}: cannot be opened: {' '.join(str(error).split())}") from None
