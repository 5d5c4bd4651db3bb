"""Commanded pelvis pose of the standing robot: x, y, z, roll, pitch and yaw in the support frame.

The support frame lies between the soles at their height, with their heading. x and y are relative to the nominal pelvis
position; roll, pitch and yaw rotate about fixed axes in this order, R = R_z·R_y·R_x. The command is followed with
limited speed and acceleration. The controller balances the CoM, so the model converts the pelvis position to a CoM
position, with the feet held in place by the legs' inverse kinematics.
"""

import mujoco
import numpy as np
import numpy.typing as npt

from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.control.kinematics import ModelJoints
from valor.control.state import RobotState
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.limiter import Limiter
from valor.robot.model import Model

Places = npt.NDArray[np.intp]

HORIZON = 0.02  # Duration for which a command is extrapolated by its velocity [s]
HEIGHT = 2  # index of the height among the six
_SOLVED = 1e-6  # of the legs' inverse kinematics [m, rad]


class PelvisReference:
    """Follows the commanded pelvis pose."""

    def __init__(self, model: Model, leg_places: Places) -> None:
        """Start at home; ``leg_places`` (m,) are the leg joints among the model's."""
        robot = model.robot
        self.limits = CommandedLimits.of_pelvis(robot)  # limits of the six coordinates
        self.home = np.array((0.0, 0.0, robot.tables.nominal_base_height, 0.0, 0.0, 0.0))  # nominal pose
        self._limiter = Limiter(self.limits)
        self._legs = LegKinematics(model, ModelJoints(model), leg_places)
        self._everywhere = np.ones(6, dtype=bool)
        self._target, self._rate = self.home.copy(), np.zeros(6)
        self._led_at = -np.inf
        self._still = False
        self.reset()

    @property
    def position(self) -> FloatArray:
        """(6,) pose commanded in this period."""
        return self._limiter.position

    @property
    def com_displacement(self) -> FloatArray:
        """(3,) displacement of the CoM from the nominal posture, in support [m]."""
        return self._legs.com_displacement

    @property
    def legs(self) -> FloatArray:
        """(m,) joint angles of the legs for this pose [rad]."""
        return self._legs.position

    @property
    def resting(self) -> bool:
        """True if the pelvis is at rest at home, at any height: steps may start."""
        away = np.abs(self._limiter.position - self.home) + np.abs(self._limiter.velocity)
        away[HEIGHT] = 0.0
        return bool(away.max() < 1e-3)

    def reset(self) -> None:
        """Return home at once, when balance starts."""
        self.go_home()
        self._target[HEIGHT] = self.home[HEIGHT]
        self._limiter.reset(self._everywhere, self.home)
        self._limiter.velocity = np.zeros(6)
        self._take()
        self._legs.reset()
        self._still = False
        self.angular_velocity = np.zeros(3)  # of the pelvis in support [rad/s]

    def go_home(self) -> None:
        """Return to the nominal pose at the present height."""
        height = self._target[HEIGHT]
        self._target = self.home.copy()
        self._target[HEIGHT] = height
        self._rate = np.zeros(6)
        self._still = False

    def lead(self, position: FloatArray, velocity: FloatArray, time: float) -> None:
        """Follow (6,) a pose within the limits, moving at (6,) ``velocity`` from robot time ``time`` [s]."""
        self._target, self._rate, self._led_at = position, velocity, time
        self._still = False

    def advance(self, now: float, dt: float) -> None:
        """Advance by ``dt`` [s] to robot time ``now`` [s]."""
        if self._still:
            return
        age = min(max(0.0, now - self._led_at), HORIZON)
        fresh = now - self._led_at < HORIZON
        limiter = self._limiter
        before, turned = limiter.position, self.rotation
        limiter.advance(self._target + age * self._rate, self._rate if fresh else np.zeros(6), dt)
        if not (limiter.position != before).any():
            if not self._legs.solved:
                self._legs.update(before, self.rotation)
            self.angular_velocity = np.zeros(3)
            self._still = self._legs.solved and not fresh and not limiter.velocity.any()
            return
        self._take()
        self.angular_velocity = np.array(rotation.error(self.rotation, turned)) / dt
        self._legs.update(limiter.position, self.rotation)

    def _take(self) -> None:
        roll, pitch, yaw = self._limiter.position[3:].tolist()
        self.rotation = rotation.from_roll_pitch_yaw(roll, pitch, yaw)  # (3, 3) of the pelvis in support

    def measured(self, state: RobotState) -> FloatArray:
        """Return (6,) the estimated pelvis pose."""
        return state.pelvis_in_support - self._legs.nominal_place


class LegKinematics:
    """Inverse kinematics of the legs in the nominal stance, for a pelvis pose: one Newton step per call."""

    def __init__(self, model: Model, joints: ModelJoints, legs: Places) -> None:
        robot, self._model = model.robot, model.mj
        self._data = data = mujoco.MjData(model.mj)
        feet = robot.tables.feet
        self._sites = [model.site(foot.sole) for foot in (feet.left, feet.right)]
        self._groups = [joints.group("left_leg"), joints.group("right_leg")]
        self._places = legs
        self._lower = robot.lower[joints.places][legs]
        self._upper = robot.upper[joints.places][legs]
        self._nominal: FloatArray = robot.nominal_posture[joints.places][legs].copy()
        self._jacobian = np.zeros((6, model.mj.nv))
        self._com: FloatArray = data.subtree_com[model.body(robot.tables.base)]
        data.qpos[:] = 0.0
        data.qpos[3] = 1.0
        data.qpos[7:] = robot.nominal_posture[joints.places]
        self._evaluate()
        self._middle = self._soles().mean(axis=0)  # the support frame's origin, from the pelvis
        self._stance = self._soles() - self._middle
        self._level = [data.site_xmat[site].reshape(3, 3).copy() for site in self._sites]
        self._nominal_com: FloatArray = self._com - self._middle
        self._nominal_height = robot.tables.nominal_base_height
        self.nominal_place = np.zeros(6)  # pelvis pose in support in the nominal posture; only x and y are not 0 [m]
        self.nominal_place[:2] = -self._middle[:2]
        self.reset()

    def reset(self) -> None:
        """Return to the nominal posture."""
        self.position = self._nominal  # (m,) of the leg joints [rad]
        self.com_displacement = np.zeros(3)  # from the nominal posture, in support [m]
        self.solved = True  # whether the soles are at their targets

    def update(self, pelvis: FloatArray, turn: FloatArray) -> None:
        """Move pelvis and legs to (6,) a pose in support, whose rotation is given by (3, 3) ``turn``."""
        data = self._data
        data.qpos[0] = pelvis[0] - self._middle[0]
        data.qpos[1] = pelvis[1] - self._middle[1]
        data.qpos[2] = pelvis[2] - self._nominal_height - self._middle[2]
        mujoco.mju_mat2Quat(data.qpos[3:7], turn.ravel())
        data.qpos[7 + self._places] = self.position
        self._evaluate()
        soles = self._soles()
        change = np.zeros(len(self._places))
        errors = []
        for i, (site, group) in enumerate(zip(self._sites, self._groups, strict=True)):
            mujoco.mj_jacSite(self._model, data, self._jacobian[:3], self._jacobian[3:], site)
            error = np.concatenate(
                (self._stance[i] - soles[i], rotation.error(self._level[i], data.site_xmat[site].reshape(3, 3)))
            )
            errors.append(np.abs(error).max())
            change[np.searchsorted(self._places, group)] = np.linalg.solve(self._jacobian[:, 6 + group], error)
        self.solved = max(errors) < _SOLVED
        self.position = np.clip(self.position + change, self._lower, self._upper)
        self.com_displacement = self._com - soles.mean(axis=0) - self._nominal_com

    def _evaluate(self) -> None:
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)

    def _soles(self) -> FloatArray:
        """(2, 3) positions of the soles [m]."""
        soles: FloatArray = self._data.site_xpos[self._sites]
        return soles
