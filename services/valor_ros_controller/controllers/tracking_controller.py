"""Follows joints that the Motion System leads: says where they are and shall be, and takes no goals.

Team ViGIR's tracking controllers did so for the legs while the robot's own controller had them.
"""

from __future__ import annotations

from valor.valor_ros_controller.controller_manager import Onlooker
from valor.valor_ros_controller.controllers.configuration import TrackingControllerConfig
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface


class TrackingController(Onlooker):
    """One limb that is only looked at: it claims nothing.

    Attributes:
        joints: (n,) places of its joints in the hardware interface's vectors.
        refusal: of any goal, for its sender.
    """

    type = "valor_ros_controller/TrackingController"

    def __init__(self, name: str, config: TrackingControllerConfig, hw: ValorEscherHWInterface) -> None:
        self.name = name
        self.joints = hw.group_indices(config.groups)
        self.limits = hw.limits(self.joints)
        self.refusal = f"{name} takes no goals: {config.goals}"
