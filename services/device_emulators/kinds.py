"""Which emulator stands at the far end of which kind of device."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from valor.common.errors import ConfigurationError
from valor.common.instance import Instance, Settings
from valor.device_emulators.dynamixel import DynamixelEmulator
from valor.device_emulators.emulator import Emulator
from valor.device_emulators.force_torque import ForceTorqueEmulator
from valor.device_emulators.hdt_modules import HdtModules
from valor.device_emulators.microstrain import MicroStrainEmulator
from valor.device_emulators.series_elastic import SeriesElasticEmulator
from valor.robot.description import RobotDescription

Maker = Callable[[str, Instance, Settings, RobotDescription], Emulator]

KINDS: Mapping[str, Maker] = {
    "sea_can_fd": SeriesElasticEmulator,
    "ft_can": ForceTorqueEmulator,
    "hdt_bifrost": HdtModules,
    "microstrain_mip": MicroStrainEmulator,
    "dynamixel_2": DynamixelEmulator,
}


def make(name: str, instance: Instance, settings: Settings, robot: RobotDescription) -> Emulator:
    """The emulator of a device.

    Raises:
        ConfigurationError: there is none of its kind, or its port cannot be opened.
    """
    kind = robot.tables.devices[name].kind
    if kind not in KINDS:
        raise ConfigurationError(
            f"{robot.folder / 'robot.yaml'}: devices.{name}: no emulator of kind {kind}; expected {', '.join(KINDS)}"
        )
    return KINDS[kind](name, instance, settings, robot)
