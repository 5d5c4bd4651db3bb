"""Which emulator stands at the far end of which kind of device."""

from __future__ import annotations

from valor.common.instance import Instance, Settings
from valor.device_emulators.emulator import Emulator
from valor.devices.kinds import KINDS
from valor.robot.description import RobotDescription


def make(name: str, instance: Instance, settings: Settings, robot: RobotDescription) -> Emulator:
    """The emulator of a device.

    Raises:
        ConfigurationError: its port cannot be opened.
    """
    emulator: Emulator = KINDS[robot.tables.devices[name].kind].load_emulator()(name, instance, settings, robot)
    return emulator
