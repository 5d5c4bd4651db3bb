"""Where devices are plugged in: CAN buses by number, serial ports by the device's name.

The instance's settings may name real ones: ``can0: socketcan:can0``, ``imu: /dev/ttyACM0``. What they do not name is
where the device emulators are: a CAN bus is UDP multicast that does not leave the computer, on a port of the instance's
own; a serial port is a pseudo-terminal, linked to ``ports/<device>`` in the instance's folder.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import can

from valor.common.errors import ConfigurationError
from valor.common.instance import Instance, Settings
from valor.devices import multicast_filter

_FIRST_PORT = 5500  # UDP; eight for each ROS domain, of which there are 101
_BUSES = 8


def serial_port(instance: Instance, settings: Settings, device: str) -> Path:
    """The serial port of a device."""
    return Path(settings.ports.get(device) or instance.ports / device)


def open_can(
    settings: Settings, bus: int, kinds: Sequence[int], mask: int, data_bit_rate: int = 5_000_000
) -> can.BusABC:
    """Open a CAN FD bus, to hear frames of some kinds.

    Args:
        settings: of the instance.
        bus: its number.
        kinds: identifiers under the mask. Others are thrown away by the kernel where it knows how.
        mask: of the identifier's bits that are the kind.
        data_bit_rate: on a real bus [bit/s].

    Raises:
        ConfigurationError: it cannot be opened.
    """
    if not 0 <= bus < _BUSES:
        raise ConfigurationError(f"CAN bus {bus}: expected 0 to {_BUSES - 1}")
    name = f"can{bus}"
    try:
        if place := settings.ports.get(name):
            interface, _, channel = place.partition(":")
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
        multicast_filter.attach(opened.fileno(), kinds, mask)
        return opened
    except (can.CanError, can.CanInterfaceNotImplementedError, OSError, ValueError) as error:
        raise ConfigurationError(f"port {name}: cannot be opened: {' '.join(str(error).split())}") from None
