"""Contacts and loads of the hands, by the forces of their wrist sensors.

A hand that is pulled down carries a load; its smoothed weight is compensated by the arm's joints with Jᵀ·weight. A hand
that is pushed sideways or up presses on something; its servos then integrate no further. A hand that presses or lifts
with more than ``most_pressing`` for ``RESISTED`` is *resisted*: the object does not give, and the robot would tip.
"""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.messages import Proprioceptor
from valor.control.kinematics import ModelJoints
from valor.control.state import RobotState
from valor.motion_manager.hands.hand_goals import SIDES
from valor.motion_manager.joints.servos import ServoCompensation
from valor.robot.model import Model
from valor.robot.tables import Hands

LOOK = 0.02  # period of updates [s]
SMOOTHING = 0.3  # time constant of a load [s]
NOTHING = 1.0  # smallest load [N]
RESISTED = 0.1  # duration of a large force, so that knocks do not count [s]


class HandContacts:
    """Contacts of both hands, with hysteresis of the force."""

    def __init__(self, hands: Hands) -> None:
        self._on, self._off = hands.contact_on**2, hands.contact_off**2
        self.contacts: npt.NDArray[np.uint8] = np.zeros(2, dtype=np.uint8)  # left, right; a new array at each change
        self._before = (0, 0)

    @property
    def touching(self) -> bool:
        """True if any hand is in contact."""
        return any(self._before)

    def update(self, proprioceptor: Proprioceptor) -> None:
        """Process the measured wrenches."""
        left, right = self._before
        now = (
            self._touches(proprioceptor.left_hand_wrench, left),
            self._touches(proprioceptor.right_hand_wrench, right),
        )
        if now != self._before:
            self._before = now
            self.contacts = np.array(now, dtype=np.uint8)

    def _touches(self, wrench: FloatArray, before: int) -> int:
        x, y, z, *_ = wrench.tolist()
        return int(x * x + y * y + z * z > (self._off if before else self._on))


class HandLoads:
    """Loads of both hands, for the compensation of the arms' servos."""

    def __init__(self, model: Model, servos: ServoCompensation) -> None:
        robot = model.robot
        self._model, self._data = model.mj, mujoco.MjData(model.mj)
        self._data.qpos[:3] = 0.0
        self._servos, self._pressing = servos, robot.tables.hands.contact_on
        self._max_force = robot.tables.hands.most_pressing
        joints = ModelJoints(model)
        # Side → site; for an arm with compensated servos, degrees of freedom and indices among the servos.
        self._hands: dict[int, tuple[int, tuple[Any, Any] | None]] = {}
        for name, hand in robot.tables.hands.present():
            arm = robot.group_indices(f"{name}_arm") if robot.tables.group(f"{name}_arm") else np.zeros(0, dtype=int)
            if arm.size:
                compensated = np.isin(arm, servos.joints).all()
                indices = np.searchsorted(servos.joints, np.sort(arm))
                servo = (6 + joints.group(f"{name}_arm"), indices) if compensated else None
                self._hands[SIDES.index(name)] = (model.site(hand.site), servo)
        self._jacobian = np.zeros((3, model.mj.nv))
        self.weights, self.resisted = [0.0, 0.0], [0.0, 0.0]  # of left, right; force of a resisted hand, else 0 [N]
        self._large_since = [np.inf, np.inf]  # start of a large force [s]
        self._updated = -np.inf
        self._loaded = False

    def update(self, proprioceptor: Proprioceptor, state: RobotState, contacts: HandContacts, now: float) -> None:
        """Process one period, at robot time ``now`` [s]."""
        if not (contacts.touching or self._loaded) or now - self._updated < LOOK:
            return
        fraction = min(1.0, min(now - self._updated, 2.0 * LOOK) / SMOOTHING)
        self._updated = now
        self._data.qpos[3:] = state.kinematics.configuration
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        wrenches = (proprioceptor.left_hand_wrench, proprioceptor.right_hand_wrench)
        for side, (site, servo) in self._hands.items():
            touching = bool(contacts.contacts[side])
            force = self._data.site_xmat[site].reshape(3, 3) @ wrenches[side][:3]
            pressed = _pressed(force) if touching else 0.0
            lifted = -float(force[2])
            self._resist(side, max(pressed, lifted), now)
            pressing = pressed > self._pressing or self.resisted[side] > 0.0
            if servo is None:
                continue
            dof, indices = servo
            if not pressing:
                felt = min(max(lifted, 0.0), self._max_force) if touching else 0.0
                weight = self.weights[side] + fraction * (felt - self.weights[side])
                self.weights[side] = weight if felt or weight > NOTHING else 0.0
            mujoco.mj_jacSite(self._model, self._data, self._jacobian, None, site)
            self._servos.load[indices] = self._jacobian[2, dof] * self.weights[side]
            self._servos.pressing[indices] = pressing
        self._loaded = contacts.touching or any(self.weights)

    def _resist(self, side: int, pressed: float, now: float) -> None:
        """Update ``resisted`` by the force with which a hand presses or lifts [N]."""
        since = self._large_since[side] = min(self._large_since[side], now) if pressed > self._max_force else np.inf
        self.resisted[side] = pressed if now - since >= RESISTED else 0.0
        if self.resisted[side]:  # a downward force may be no weight, and must not be compensated
            self.weights[side] = 0.0


def _pressed(force: FloatArray) -> float:
    """Force with which a hand presses sideways or down, from the force (3,) of the world on it in odom axes [N]."""
    x, y, z = map(float, force)
    return max(math.hypot(x, y), z)
