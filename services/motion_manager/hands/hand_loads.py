"""What hands carry, and whether they press on something: by the forces at the wrists of hands that touch.

A hand that is pulled down carries a load; its weight is smoothed, kept while it is felt, and held by the arm's joints
with Jᵀ·weight. One that is pushed aside or up presses on something, and nothing is done to press more; one that presses
harder than ``most_pressing`` for a while is *resisted*: what it presses on does not give, and the robot would tip.
"""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.messages import Proprioceptor
from valor.motion_manager.hands.hand_contact import HandContacts
from valor.motion_manager.hands.hand_goals import SIDES
from valor.motion_manager.joints.servo_compensation import ServoCompensation
from valor.robot.model import Model
from valor.whole_body.model.dynamics import ModelJoints
from valor.whole_body.state import RobotState

LOOK = 0.02  # between looks at where the hands are [s]
SMOOTHING = 0.3  # of a load [s]
HEAVIEST = 60.0  # load that is held [N]
NOTHING = 1.0  # load that is none [N]
RESISTED = 0.1  # for which a hand presses too hard, so that no knock counts [s]


class HandLoads:
    """Both hands; tells the compensation of the arms' servos.

    Attributes:
        weights: left, right [N].
        resisted: left, right: with what a hand presses that is resisted, else 0 [N].
    """

    def __init__(self, model: Model, servos: ServoCompensation) -> None:
        robot = model.robot
        self._model, self._data = model.mj, mujoco.MjData(model.mj)
        self._data.qpos[:3] = 0.0
        self._servos, self._pressing = servos, robot.tables.hands.contact_on
        self._most = robot.tables.hands.most_pressing
        joints = ModelJoints(model)
        # Site; of an arm whose servos are compensated, its degrees of freedom and places among the servos.
        self._hands: dict[int, tuple[int, tuple[Any, Any] | None]] = {}
        for name, hand in robot.tables.hands.present():
            arm = robot.group_indices(f"{name}_arm") if robot.tables.group(f"{name}_arm") else np.zeros(0, dtype=int)
            if arm.size:
                compensated = np.isin(arm, servos.joints).all()
                places = np.searchsorted(servos.joints, np.sort(arm))
                servo = (6 + joints.group(f"{name}_arm"), places) if compensated else None
                self._hands[SIDES.index(name)] = (model.site(hand.site), servo)
        self._jacobian = np.zeros((3, model.mj.nv))
        self.weights, self.resisted = [0.0, 0.0], [0.0, 0.0]
        self._too_hard = [np.inf, np.inf]  # since when a hand presses too hard [s]
        self._looked = -np.inf
        self._felt = False  # whether there is anything to forget

    def update(self, proprioceptor: Proprioceptor, state: RobotState, contacts: HandContacts, now: float) -> None:
        """A period, at robot time ``now`` [s]."""
        if not (contacts.touching or self._felt) or now - self._looked < LOOK:
            return
        share = min(1.0, min(now - self._looked, 2.0 * LOOK) / SMOOTHING)
        self._looked = now
        self._data.qpos[3:] = state.dynamics.configuration
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        wrenches = (proprioceptor.left_hand_wrench, proprioceptor.right_hand_wrench)
        for side, (site, servo) in self._hands.items():
            touches = bool(contacts.contacts[side])
            force = self._data.site_xmat[site].reshape(3, 3) @ wrenches[side][:3]
            pressed = _pressed(force) if touches else 0.0
            pressing = pressed > self._pressing
            self._resist(side, pressed, now)
            if servo is None:
                continue
            dof, places = servo
            if not pressing:
                felt = min(max(-float(force[2]), 0.0), HEAVIEST) if touches else 0.0
                weight = self.weights[side] + share * (felt - self.weights[side])
                self.weights[side] = weight if felt or weight > NOTHING else 0.0
            mujoco.mj_jacSite(self._model, self._data, self._jacobian, None, site)
            self._servos.load[places] = self._jacobian[2, dof] * self.weights[side]
            self._servos.pressing[places] = pressing
        self._felt = contacts.touching or any(self.weights)

    def _resist(self, side: int, pressed: float, now: float) -> None:
        """Note with what a hand presses [N]."""
        since = self._too_hard[side] = min(self._too_hard[side], now) if pressed > self._most else np.inf
        self.resisted[side] = pressed if now - since >= RESISTED else 0.0
        if self.resisted[side]:  # what pushes it down is no weight, perhaps, and is not to be pushed back
            self.weights[side] = 0.0


def _pressed(force: FloatArray) -> float:
    """With what a hand presses aside or down, by the force (3,) of the world on it, in odom's axes [N]."""
    x, y, z = map(float, force)
    return max(math.hypot(x, y), z)
