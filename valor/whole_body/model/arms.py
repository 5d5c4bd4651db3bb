"""What the commanded arms do to the centre of mass and to the chest.

A controller that only keeps the CoM moves the torso back when an arm goes forward (thesis 5.3). So the CoM's reference
moves with the arms, by as much as they would move it with the legs and pelvis frozen: then the torso stays.
"""

from __future__ import annotations

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.robot.model import Model
from valor.whole_body.model.dynamics import ModelJoints


class UpperBodyKinematics:
    """The model with its pelvis frozen, level at the origin, its legs nominal.

    Attributes:
        nominal_com_height: of the CoM above the soles in the nominal posture [m].
        com: (3,) in pelvis [m], and nominal_com: likewise, in the nominal posture.
    """

    def __init__(self, model: Model) -> None:
        robot = model.robot
        joints = ModelJoints(model)
        self._model = model.mj
        self._data = data = mujoco.MjData(model.mj)
        self._legs = joints.group("left_leg", "right_leg")
        self._upper = joints.group("torso", "left_arm", "right_arm")
        self._nominal: FloatArray = robot.nominal_posture[joints.places]
        data.qpos[:] = 0.0
        data.qpos[3] = 1.0
        data.qpos[7:] = self._nominal
        self.com: FloatArray = data.subtree_com[model.body(robot.tables.base)]
        self._chest: FloatArray = data.xmat[model.body(robot.tables.chest)].reshape(3, 3)
        self._evaluate()
        self.nominal_com = self.com.copy()
        feet = robot.tables.feet
        soles = [data.site_xpos[model.site(foot.sole)][2] for foot in (feet.left, feet.right)]
        self.nominal_com_height = float(self.com[2] - np.mean(soles))
        self._places = 7 + self._upper
        self._last = b""

    def update(self, position: FloatArray) -> None:
        """Move the upper body to ``position``: (nj,) of the model's joints [rad], those of the legs unread."""
        upper = position[self._upper]
        if (numbers := upper.tobytes()) != self._last:
            self._last = numbers
            self._data.qpos[self._places] = upper
            self._evaluate()

    def com_displacement(self) -> FloatArray:
        """(3,) of the CoM from where it is in the nominal posture, in pelvis [m]."""
        result: FloatArray = self.com - self.nominal_com
        return result

    def chest_rotation(self) -> FloatArray:
        """(3, 3) of the chest in pelvis."""
        return self._chest

    def _evaluate(self) -> None:
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
