"""``motion_manager/pelvis``: where the pelvis shall be while the robot stands; while it steps, its height alone."""

from __future__ import annotations

import numpy as np

from bifrost import Received
from valor.common.behaviors import Locomotion
from valor.common.messages import PelvisSetpoint
from valor.common.topics import PELVIS
from valor.motion_manager.handlers.joint_setpoints import STALE
from valor.motion_manager.handlers.rejections import Rejections
from valor.motion_manager.states.behavior_fsm import BehaviorFsm
from valor.motion_manager.whole_body.balance.pelvis import HEIGHT, PelvisReference


class PelvisHandler:
    """Checks set-points, brings them within the limits of robot.yaml and hands them to the pelvis' reference."""

    def __init__(self, fsm: BehaviorFsm, pelvis: PelvisReference, rejections: Rejections) -> None:
        self._fsm = fsm
        self._pelvis = pelvis
        self._rejections = rejections

    def handle(self, received: Received[PelvisSetpoint], now: int) -> bool:
        """Follow a set-point or refuse it, at robot time ``now`` [ns]; returns whether it is followed."""
        message = received.message
        if fault := self._fault(message, now):
            self._rejections.add(PELVIS.name, received.origin, *fault)
            return False
        limits = self._pelvis.limits
        position, velocity = limits.position_within(message.position), limits.velocity_within(message.velocity)
        self._pelvis.lead(position, velocity, 1e-9 * message.time)
        return True

    def _fault(self, message: PelvisSetpoint, now: int) -> tuple[str, str] | None:
        """What kind of fault a message has, and the reason for a person."""
        locomotion = self._fsm.locomotion
        if locomotion is not Locomotion.STAND and not locomotion.stepping:
            return "behavior", f"the pelvis is led while the robot stands; it is in behavior {self._fsm.behavior}"
        for what, vector in (("position", message.position), ("velocity", message.velocity)):
            if vector.shape != (6,):
                return "length", f"{what} has {vector.size} numbers; expected 6: x, y, z, roll, pitch, yaw"
            if not np.isfinite(vector).all():
                return "number", f"{what} {vector.tolist()} is not finite"
        age = 1e-9 * (now - message.time)
        if abs(age) > STALE:
            return "stale", f"made for a state {age:.3f} s old; expected at most {STALE} s"
        if locomotion.stepping and np.abs(np.delete(message.position, HEIGHT)).max() > 0.0:
            return (
                "stepping",
                f"in behavior {self._fsm.behavior} the pelvis' height alone is led; expected zeros beside it",
            )
        return None
