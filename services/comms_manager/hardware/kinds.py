"""Which driver speaks to which kind of device."""

from __future__ import annotations

from valor.comms_manager.hardware.device import Device, DeviceContext
from valor.devices.kinds import KINDS


def make(name: str, context: DeviceContext) -> Device:
    """The driver of a device of robot.yaml; its ports are not opened yet."""
    device: Device = KINDS[context.robot.tables.devices[name].kind].load_driver()(name, context)
    return device
