"""Landing of a robot that falls forward or backward: its legs fold and its arms give way; then all joints are limp.

A fall is certain a third to half a second before the ground is reached. Forward, the robot kneels, and its hands are in
front of the head. Backward, it squats with flexed hips and folded arms, which keep the head off the ground while the
pelvis takes the load. To the side, a limp robot lands on its arm, and nothing tried was better.
"""

from math import atan2, pi

import numpy as np

from valor.common.arrays import FloatArray
from valor.control.state import RobotState
from valor.robot.checks.stance import Stance
from valor.robot.description import RobotDescription
from valor.robot.tables import SIDES

LONGEST = 1.5  # from the detection of the fall until limp [s]
FASTEST = 6.0  # of a joint's set-point [rad/s]
YIELDING = 0.5  # stiffness, relative to the joints' servos
WIDTH = pi / 3  # directions at most so far from straight ahead, or back, count as such [rad]


class Landing:
    """Joint set-points of a falling robot."""

    def __init__(self, robot: RobotDescription) -> None:
        """Raises ConfigurationError: the model is invalid."""
        self.stiffness: FloatArray = YIELDING * robot.servo_stiffness  # (n,) [N·m/rad]
        self._fastest = np.minimum(robot.velocity_limit, FASTEST)
        stance = Stance(robot)
        self._forward = _folded(stance, hip=-0.3, knee=1.4, ankle=0.2, arms="up")
        self._backward = _folded(stance, hip=2.0, knee=2.0, ankle=0.6, arms="fold")
        self._goal = self.position = self.velocity = robot.nominal_posture  # set-points [rad, rad/s]
        self._began = 0.0
        self.active = False

    def begin(self, state: RobotState, now: float) -> None:
        """Start from the measured joint positions at robot time ``now`` [s], unless the robot falls to the side."""
        middle = state.sole_positions_in_odom.mean(axis=0)
        ahead, left, _ = (state.pelvis_rotation_in_odom.T @ (state.dcm_in_odom - middle)).tolist()
        aside = abs(atan2(left, ahead))
        self.active = not WIDTH < aside < pi - WIDTH
        self._goal = self._forward if aside <= WIDTH else self._backward
        self.position, self._began = state.joint_position.copy(), now

    def update(self, now: float, dt: float) -> None:
        """Move the set-points by a period ``dt`` [s], or end."""
        self.active = self.active and now - self._began < LONGEST
        step = np.clip(self._goal - self.position, -self._fastest * dt, self._fastest * dt)
        self.position, self.velocity = self.position + step, step / dt


def _folded(stance: Stance, *, hip: float, knee: float, ankle: float, arms: str) -> FloatArray:
    """(n,) nominal posture with bent legs [rad], and the arms in a preset, if the robot has it."""
    robot = stance.robot
    goal = robot.nominal_posture.copy()
    for side in SIDES:
        for name, turn in zip(stance.pitch_joints(side), (-hip, knee, -ankle), strict=False):
            goal[robot.index[name]] += turn * np.sign(stance.data.joint(name).xaxis @ stance.base[1][:, 1])
    for angles in robot.tables.arm_presets.get(arms, {}).values():
        goal[[robot.index[name] for name in angles]] = list(angles.values())
    return np.clip(goal, robot.lower, robot.upper)
