"""A robot with force/torque sensors in its feet, or without."""

from msgspec import structs

from valor.devices.table import FtCan, WrenchPlace, WrenchSensor
from valor.robot.description import RobotDescription


def with_foot_sensors(robot: RobotDescription, sensed: bool) -> RobotDescription:
    """The robot, whose ``devices`` list these sensors or do not; nothing else of it changes in simulation."""
    feet: tuple[WrenchPlace, ...] = ("left_foot", "right_foot")
    sensors = [WrenchSensor(id=row, at=foot, serial=f"FT-{row}", firmware="1") for row, foot in enumerate(feet, 1)]
    devices = {name: device for name, device in robot.tables.devices.items() if not isinstance(device, FtCan)}
    devices |= {"force_torque": FtCan(bus=0, sensors=sensors)} if sensed else {}
    return RobotDescription(robot.folder, structs.replace(robot.tables, devices=devices))
