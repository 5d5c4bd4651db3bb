"""``comms_manager/devices``: how the devices fare, and what that demands of the Motion System."""

from __future__ import annotations

from typing import Self

from bifrost import Received
from valor.common.messages import DeviceStatus
from valor.common.topics import DEVICES
from valor.motion_manager.handlers.handler import Handler
from valor.motion_manager.handlers.rejections import Rejections
from valor.motion_manager.parts import Parts
from valor.motion_manager.safety.device_reactions import DeviceReactions


class DevicesHandler(Handler[DeviceStatus]):
    """Hands the Comms Manager's word on; that of a bag that is played back is not heard."""

    topic = DEVICES
    after_motor = True

    def __init__(self, reactions: DeviceReactions, rejections: Rejections) -> None:
        super().__init__(rejections)
        self._reactions = reactions

    @classmethod
    def of(cls, parts: Parts) -> Self:
        """The one of a Motion Manager."""
        return cls(parts.device_reactions, parts.rejections)

    def obey(self, received: Received[DeviceStatus], now: int) -> None:
        """Take note of it."""
        if received.origin == DEVICES.owner:
            self._reactions.hear(received.message)
