"""Which driver speaks to which kind of device."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from valor.common.errors import ConfigurationError
from valor.comms_manager.hardware.device import Device, DeviceContext
from valor.comms_manager.hardware.dynamixel import DynamixelServos
from valor.comms_manager.hardware.force_torque import ForceTorque
from valor.comms_manager.hardware.hdt import Hdt
from valor.comms_manager.hardware.microstrain import MicroStrain
from valor.comms_manager.hardware.series_elastic import SeriesElastic

KINDS: Mapping[str, Callable[[str, DeviceContext], Device]] = {
    "sea_can_fd": SeriesElastic,
    "ft_can": ForceTorque,
    "hdt_bifrost": Hdt,
    "microstrain_mip": MicroStrain,
    "dynamixel_2": DynamixelServos,
}


def make(name: str, context: DeviceContext) -> Device:
    """The driver of a device of robot.yaml.

    Raises:
        ConfigurationError: there is none for its kind.
    """
    kind = context.robot.tables.devices[name].kind
    if kind not in KINDS:
        file = context.robot.folder / "robot.yaml"
        raise ConfigurationError(f"{file}: devices.{name}: no driver of kind {kind}; expected {', '.join(KINDS)}")
    return KINDS[kind](name, context)
