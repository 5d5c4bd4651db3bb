"""``motion_manager/pelvis``: where the pelvis shall be while the robot stands; while it steps, its height alone."""

from __future__ import annotations

from typing import Self

import numpy as np

from bifrost import Received
from valor.common.behaviors import Locomotion
from valor.common.errors import RefusalError
from valor.common.messages import PelvisSetpoint
from valor.common.topics import PELVIS
from valor.motion_manager.handlers.handler import Handler, require_finite, require_fresh
from valor.motion_manager.handlers.rejections import Rejections
from valor.motion_manager.parts import Parts
from valor.motion_manager.states.behavior_fsm import BehaviorFsm
from valor.whole_body.balance.pelvis import HEIGHT, PelvisReference


class PelvisHandler(Handler[PelvisSetpoint]):
    """Checks set-points, brings them within the limits of robot.yaml and hands them to the pelvis' reference."""

    topic = PELVIS

    def __init__(self, fsm: BehaviorFsm, pelvis: PelvisReference, rejections: Rejections) -> None:
        super().__init__(rejections)
        self._fsm = fsm
        self._pelvis = pelvis

    @classmethod
    def of(cls, parts: Parts) -> Self:
        """The one of a Motion Manager."""
        return cls(parts.fsm, parts.controller.pelvis, parts.rejections)

    def obey(self, received: Received[PelvisSetpoint], now: int) -> None:
        """Lead the pelvis."""
        message = received.message
        self._check(message, now)
        limits = self._pelvis.limits
        position, velocity = limits.position_within(message.position), limits.velocity_within(message.velocity)
        self._pelvis.lead(position, velocity, 1e-9 * message.time)

    def _check(self, message: PelvisSetpoint, now: int) -> None:
        locomotion = self._fsm.locomotion
        if locomotion is not Locomotion.STAND and not locomotion.stepping:
            raise RefusalError(
                "behavior", f"the pelvis is led while the robot stands; it is in behavior {self._fsm.behavior}"
            )
        for what, vector in (("position", message.position), ("velocity", message.velocity)):
            if vector.shape != (6,):
                raise RefusalError("length", f"{what} has {vector.size} numbers; expected 6: x, y, z, roll, pitch, yaw")
            require_finite(what, vector)
        require_fresh(message.time, now)
        if locomotion.stepping and np.abs(np.delete(message.position, HEIGHT)).max() > 0.0:
            raise RefusalError(
                "stepping",
                f"in behavior {self._fsm.behavior} the pelvis' height alone is led; expected zeros beside it",
            )
