"""Controllers without commands: of limbs that the Motion System controls, and of footstep plans."""

from typing import Self

from valor.valor_ros_controller.controller_manager import Controller, Resources
from valor.valor_ros_controller.controllers.configuration import TrackingControllerConfig
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface


class TrackingController(Controller):
    """Reports position and set-point of a limb that the Motion System controls; rejects all goals."""

    type = "valor_ros_controller/TrackingController"
    config = TrackingControllerConfig

    def __init__(self, name: str, config: TrackingControllerConfig, hw: ValorEscherHWInterface) -> None:
        self.name = name
        self.joints = hw.group_indices(config.groups)  # (n,) indices of its joints in the hardware interface's vectors
        self.limits = hw.limits(self.joints)
        self.rejection = f"{name} accepts no goals: {config.goals}"  # of every goal

    @classmethod
    def make(cls, name: str, config: TrackingControllerConfig, resources: Resources) -> Self:
        return cls(name, config, resources.hw)


class FootstepController(Controller):
    """Stands for the Footstep Converter in the modes in which footstep plans are accepted."""

    type = "valor_ros_controller/FootstepController"
