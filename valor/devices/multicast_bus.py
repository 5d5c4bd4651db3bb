"""The multicast CAN bus: `python-can`'s frames on the wire, at a third of what they cost through its layers.

Between emulated devices and their drivers go thousands of frames a second, and each of them passes here twice.
"""

from __future__ import annotations

import os
import select
import socket

import can
import msgspec
from can.interfaces.udp_multicast import UdpMulticastBus

_LONGEST = 4096  # datagram [B]


class _Frame(msgspec.Struct, forbid_unknown_fields=True):
    """As `python-can` has it on the wire: a map of MessagePack, in this order."""

    timestamp: float
    arbitration_id: int
    is_extended_id: bool
    is_remote_frame: bool
    is_error_frame: bool
    channel: str | int | None
    dlc: int
    data: bytes
    is_fd: bool
    bitrate_switch: bool
    error_state_indicator: bool


class MulticastBus(UdpMulticastBus):  # type: ignore[misc]  # untyped
    """A CAN FD bus that does not leave the computer; stamps are the senders'."""

    def __init__(self, group: str, port: int) -> None:
        """Join.

        Args:
            group: multicast address.
            port: UDP.

        Raises:
            can.CanInitializationError: there is no such network.
        """
        super().__init__(group, port, hop_limit=0, fd=True)
        self._end = socket.socket(fileno=os.dup(super().fileno()))
        self._there = (group, port)
        self._encode = msgspec.msgpack.Encoder().encode
        self._decode = msgspec.msgpack.Decoder(_Frame).decode

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame; it waits for nobody.

        Raises:
            can.CanOperationError: the network does not take it.
        """
        frame = _Frame(
            msg.timestamp,
            msg.arbitration_id,
            msg.is_extended_id,
            msg.is_remote_frame,
            msg.is_error_frame,
            msg.channel,
            msg.dlc,
            msg.data,
            msg.is_fd,
            msg.bitrate_switch,
            msg.error_state_indicator,
        )
        try:
            self._end.sendto(self._encode(frame), self._there)
        except OSError as error:
            raise can.CanOperationError("failed to send via socket") from error

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame; None: there is none within the timeout [s].

        Raises:
            can.CanOperationError: what came is no frame, or the network failed.
        """
        try:
            if timeout != 0.0 and not select.select([self._end], [], [], timeout)[0]:
                return None
            data = self._end.recv(_LONGEST, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return None
        except (OSError, ValueError) as error:
            raise can.CanOperationError(f"failed to receive from socket: {error}") from error
        try:
            it = self._decode(data)
            return can.Message(
                timestamp=it.timestamp,
                arbitration_id=it.arbitration_id,
                is_extended_id=it.is_extended_id,
                is_remote_frame=it.is_remote_frame,
                is_error_frame=it.is_error_frame,
                channel=it.channel,
                dlc=it.dlc,
                data=it.data,
                is_fd=it.is_fd,
                bitrate_switch=it.bitrate_switch,
                error_state_indicator=it.error_state_indicator,
                check=True,
            )
        except (msgspec.MsgspecError, ValueError, TypeError) as error:
            raise can.CanOperationError("could not unpack received message") from error

    def fileno(self) -> int:
        """Readable when something has come."""
        return self._end.fileno()

    def shutdown(self) -> None:
        """Leave."""
        super().shutdown()
        self._end.close()
