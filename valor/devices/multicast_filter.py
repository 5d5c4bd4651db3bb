"""What a socket of the multicast CAN bus need not even wake up for.

On multicast whoever speaks hears himself: half of all frames are one's own, each would wake its sender and be unpacked.
So the kernel throws away frames of kinds that nobody listens to, as SocketCAN's own filters do on a real bus. Frames
that are not laid out as `python-can` lays them out today (msgpack: a map that begins with timestamp and identifier) get
through: whoever reads them decides.
"""

from __future__ import annotations

import ctypes
import os
import socket
import struct
from collections.abc import Sequence

_SO_ATTACH_FILTER = 26
_UDP_HEADER = 8  # the filter sees it before the data [B]
_MAP, _MAP_OF_11 = _UDP_HEADER, 0x8B
_KEY, _KEY_OF_14 = _UDP_HEADER + 20, 0xAE  # of the second entry, arbitration_id
_NUMBER, _UINT8, _UINT16 = _UDP_HEADER + 35, 0xCC, 0xCD
# Classic BPF (linux/bpf_common.h).
_LOAD_BYTE, _LOAD_HALF, _AND, _EQUAL, _JUMP, _RETURN = 0x30, 0x28, 0x54, 0x15, 0x05, 0x06
_ALL, _NOTHING = 0xFFFFFFFF, 0


def attach(file: int, kinds: Sequence[int], mask: int) -> None:
    """Have a bus' socket receive only frames whose identifier is one of some kinds under a mask.

    Args:
        file: descriptor of the socket.
        kinds: identifiers of 11 bits, under the mask.
        mask: of the identifier's bits that are the kind.

    Raises:
        OSError: the kernel does not take it.
    """
    program = _program(kinds, mask)
    code = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *each) for each in program))
    with socket.socket(fileno=os.dup(file)) as end:
        end.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, struct.pack("@HP", len(program), ctypes.addressof(code)))


def _program(kinds: Sequence[int], mask: int) -> list[tuple[int, int, int, int]]:
    """Instructions: code, how far to jump if true and if false, constant."""
    count = len(kinds)
    take = 12 + count  # place of the instruction that takes the frame
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
