"""Configuration as ROS parameters: what a table says is the default of a read-only parameter of the node."""

from __future__ import annotations

from pydantic import ValidationError

from valor_common.errors import ConfigurationError
from valor_ros_controller.controllers.joint_trajectory_controller import ControllerConfig
from valor_ros_controller.ros.node import RosThread

_NUMBERS_AND_SWITCHES = (bool, int, float)


def configured(ros: RosThread, name: str, config: ControllerConfig) -> ControllerConfig:
    """A controller's configuration with what was set by ROS parameters ``<name>.<key>``.

    Raises:
        ConfigurationError: a parameter is of the wrong type or out of range.
    """
    values = config.model_dump()
    for table, prefix in ((values, name), (values["constraints"], f"{name}.constraints")):
        for key, value in table.items():
            if isinstance(value, _NUMBERS_AND_SWITCHES):
                table[key] = ros.parameter(f"{prefix}.{key}", value, "see controllers.yaml")
    try:
        return ControllerConfig.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise ConfigurationError(f"ROS parameter {name}.{key}: {first['msg']}") from None
