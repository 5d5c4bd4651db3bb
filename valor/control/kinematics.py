"""Kinematics of the reduced model at the estimated state, from a few MuJoCo calls.

Everything is evaluated with the pelvis at the origin and without linear velocity, in the axes of odom: mass matrix,
bias forces, Jacobians and their drift depend on neither (homogeneity of space, Galilei). They are therefore evaluated
once for estimator and controllers, before the pelvis position is estimated.
"""

from collections.abc import Sequence
from math import sqrt

import casadi as ca
import mujoco
import numpy as np
import numpy.typing as npt

from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.common.kernel import Expression, Kernel, parts
from valor.common.rotation import Quaternion
from valor.control.motions import COM, FEET, Base, CentreOfMassMotion, Motions, SoleMotions
from valor.robot.model import Indices, Model


def natural_frequency(height: float, gravity: float) -> float:
    """Return ω = √(g/z) [1/s] of the DCM for a CoM ``height`` above the soles [m]."""
    return sqrt(gravity / height)


class ModelJoints:
    """Joints of the reduced model, in the order of its degrees of freedom."""

    def __init__(self, model: Model) -> None:
        count = model.mj.nv - 6
        of_dof = np.zeros(model.mj.nv, dtype=np.intp)
        of_dof[model.dof] = np.arange(len(model.robot.joints), dtype=np.intp)[model.joint_indices]
        self.count = count
        self.indices: list[int] = of_dof[6:].tolist()  # the same as a list
        first, last = self.indices[0], self.indices[-1] + 1
        contiguous = self.indices == list(range(first, last))
        self.places: Indices = slice(first, last) if contiguous else np.array(self.indices)  # in joint vectors
        self.names = tuple(model.robot.joints[place] for place in self.indices)  # their names
        self._robot = model.robot

    def group(self, *groups: str) -> npt.NDArray[np.intp]:
        """Return the indices of the model's joints that belong to the groups."""
        members = np.concatenate([self._robot.group_indices(group) for group in groups])
        return np.flatnonzero(np.isin(self.indices, members))


class Kinematics:
    """Reduced model at one state; ``sole_dofs`` move each sole relative to the pelvis position."""

    def __init__(self, model: Model) -> None:
        tables, mj = model.robot.tables, model.mj
        self.model, self.joints = model, ModelJoints(model)  # the model's joints
        self.data = data = mujoco.MjData(mj)
        base = model.body(tables.base)
        soles = (model.site(tables.feet.left.sole), model.site(tables.feet.right.sole))
        self.mass = float(mj.body_subtreemass[base])  # [kg]
        self.gravity = -float(mj.opt.gravity[2])  # [m/s²]
        self.mass_matrix = np.zeros((mj.nv, mj.nv))  # (nv, nv)
        self.bias = np.zeros(mj.nv)  # (nv,) Coriolis, centrifugal and gravity forces, of the last ``evaluate_bias``
        self._motions = motions = Motions({COM: CentreOfMassMotion(), FEET: SoleMotions(model)})
        jacobian, velocity, poses = np.zeros((motions.count, mj.nv)), np.zeros(motions.count), np.zeros(motions.size)
        self.rotation = np.eye(3)  # (3, 3) pelvis in odom
        self.joint_position: FloatArray = data.qpos[7:]  # (nj,) of the model's joints [rad]
        self.joint_velocity: FloatArray = data.qvel[6:]  # (nj,) [rad/s]
        self.velocity: FloatArray = data.qvel  # (nv,) of the model, its linear part zero
        self.com: FloatArray = data.subtree_com[base]  # (3,) from the pelvis, in odom's axes [m]
        self.com_velocity: FloatArray = velocity[motions.rows[COM]]  # (3,) relative to the pelvis' [m/s]
        self.sole_jacobian: FloatArray = jacobian[motions.rows[FEET]]  # (12, nv) see ``SoleMotions``
        of_soles = poses[motions.poses[FEET]]
        self.sole_position: FloatArray = of_soles[:6].reshape(2, 3)  # from the pelvis, in odom's axes [m]
        self.sole_rotation: FloatArray = of_soles[6:].reshape(2, 3, 3)  # in odom
        self.configuration: FloatArray = data.qpos[3:]  # (4 + nj,) input: pelvis orientation in odom, joints
        self.rates: FloatArray = data.qvel[3:]  # (3 + nj,) input: angular velocity of the pelvis in pelvis, joints
        self.sole_dofs = tuple(self._moving(int(mj.site_bodyid[site])) for site in soles)
        self._jacobians = motions.calls(data, jacobian)
        self._place = Kernel(
            "kinematics",
            self._expressions,
            (data.qpos[3:7], self.mass_matrix[:6], self.com, data.qvel, *motions.inputs(data)),
            (self.rotation, velocity, poses),
        )
        data.qpos[:] = 0.0
        data.qpos[3] = 1.0

    def update(
        self, orientation: Quaternion, angular_velocity: FloatArray, position: FloatArray, velocity: FloatArray
    ) -> None:
        """Evaluate everything at a pelvis orientation in odom and (3,) angular velocity in pelvis [rad/s].

        ``position`` and ``velocity`` are (nj,) of the model's joints [rad, rad/s].
        """
        self.configuration[:4] = orientation
        self.configuration[4:] = position
        self.rates[:3] = angular_velocity
        self.rates[3:] = velocity
        self.evaluate()

    def evaluate(self) -> None:
        """Evaluate everything at ``configuration`` and ``rates``."""
        m, d = self.model.mj, self.data
        mujoco.mj_kinematics(m, d)
        mujoco.mj_comPos(m, d)
        mujoco.mj_crb(m, d)
        mujoco.mj_comVel(m, d)
        mujoco.mj_fullM(m, d, self.mass_matrix)
        for write in self._jacobians:
            write()
        self._place()

    def evaluate_bias(self) -> None:
        """Evaluate ``bias``, after ``evaluate``: for controllers that need it."""
        mujoco.mj_rne(self.model.mj, self.data, 0, self.bias)

    def _moving(self, body: int) -> list[int]:
        m = self.model.mj
        dofs: list[int] = []
        while body > 0:
            first = int(m.body_dofadr[body])
            dofs += range(first, first + int(m.body_dofnum[body])) if first >= 0 else ()
            body = int(m.body_parentid[body])
        return sorted(dof for dof in dofs if dof >= 3)

    def _expressions(self, orientation: Expression, *given: Expression) -> Sequence[Expression]:
        """Rotation of the pelvis; velocities and poses of CoM and soles."""
        mass_rows, com, rates, *inputs = given
        turned = ca.vertcat(*(ca.horzcat(*row) for row in rotation.rows(parts(orientation))))
        still = Base(turned, mass_rows, ca.SX(6, 1), com, rates, ca.SX(3, 1), self.mass)
        _, velocities, poses, *_ = self._motions.find(still, inputs)
        return turned, velocities, poses


class UpperBodyKinematics:
    """Effect of the commanded arms on CoM and chest: the model with a level pelvis at the origin and nominal legs.

    A controller that only keeps the CoM moves the torso back when an arm goes forward (thesis 5.3). The CoM reference
    therefore moves as the arms would move the CoM with legs and pelvis frozen; the torso stays.
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
        self.com: FloatArray = data.subtree_com[model.body(robot.tables.base)]  # (3,) in pelvis, now [m]
        self.chest: FloatArray = data.xmat[model.body(robot.tables.chest)].reshape(3, 3)  # (3, 3) in pelvis
        self._evaluate()
        self.nominal_com = self.com.copy()  # (3,) in the nominal posture [m]
        feet = robot.tables.feet
        soles = [data.site_xpos[model.site(foot.sole)][2] for foot in (feet.left, feet.right)]
        self.nominal_com_height = float(self.com[2] - np.mean(soles))  # above the soles [m]
        self._places = 7 + self._upper
        self._last = b""

    def update(self, position: FloatArray) -> None:
        """Move the upper body to (nj,) positions of the model's joints [rad]; those of the legs are ignored."""
        upper = position[self._upper]
        if (numbers := upper.tobytes()) != self._last:
            self._last = numbers
            self._data.qpos[self._places] = upper
            self._evaluate()

    def _evaluate(self) -> None:
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
