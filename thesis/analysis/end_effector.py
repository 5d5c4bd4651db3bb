"""Goals, set-points and measured poses of a hand: the end-effector errors of thesis 5.4.

All poses are of the hand's frame in odom, by forward kinematics on the robot's nominal model.

- *Fixed base*: the chest, which carries the arms, keeps its initial pose, as planners and clients assume.
- *Floating base*: the chest has its estimated pose. The Whole-Body Controller keeps the center of mass over the feet,
  so the chest moves when the arm moves.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from thesis.analysis.timeline import Motion, Timeline
from valor.analysis.reading.recording import Recording, nearest
from valor.bags.errors import BagError
from valor.common.arrays import FloatArray
from valor.common.topics import JOINT_SETPOINTS, MOTION_STATE, PROPRIOCEPTOR
from valor.robot.description import RobotDescription
from valor.robot.model import full_model

RATE = 100.0  # of the poses [Hz]

Side = Literal["left", "right"]


@dataclass(frozen=True)
class Poses:
    """Poses of a frame over time.

    Attributes:
        position: (m, 3) [m].
        rotation: (m, 3, 3).
    """

    position: FloatArray
    rotation: FloatArray

    def inside(self, outer: Poses) -> Poses:
        """Compose: these poses, given in the frame whose poses are ``outer``, in the reference of ``outer``."""
        return Poses(
            outer.position + np.einsum("mij,mj->mi", outer.rotation, self.position), outer.rotation @ self.rotation
        )

    def first(self) -> Poses:
        """The first pose, as (1, …), for broadcasting."""
        return Poses(self.position[:1], self.rotation[:1])


@dataclass(frozen=True)
class PoseError:
    """Difference of the poses of two frames.

    Attributes:
        position: (m, 3) difference in odom's axes [m].
        orientation: (m, 3) roll, pitch, yaw of the rotation between them [rad].
    """

    position: FloatArray
    orientation: FloatArray

    @classmethod
    def of(cls, actual: Poses, wanted: Poses) -> PoseError:
        """Actual minus wanted."""
        turn = np.swapaxes(wanted.rotation, -1, -2) @ actual.rotation
        return cls(actual.position - wanted.position, Rotation.from_matrix(turn).as_euler("xyz"))

    @property
    def distance(self) -> FloatArray:
        """(m,) between the positions [m]."""
        made: FloatArray = np.linalg.norm(self.position, axis=1)
        return made

    @property
    def angle(self) -> FloatArray:
        """(m,) angle of the rotation between them [rad]."""
        made: FloatArray = Rotation.from_euler("xyz", self.orientation).magnitude()
        return made


class Hand:
    """Forward kinematics of a hand and of the chest that carries its arm."""

    def __init__(self, robot: RobotDescription, side: Side) -> None:
        self._model = full_model(robot)
        self._data = mujoco.MjData(self._model.mj)
        hand = getattr(robot.tables.hands, side)
        if hand is None:
            raise BagError(f"robot {robot.name!r} has no {side} hand")
        self._site = self._model.site(hand.site)
        self._chest = self._model.body(robot.tables.chest)

    def in_chest(self, joints: FloatArray) -> Poses:
        """The hand in the chest's frame, for joint positions (m, n) [rad]."""
        return self._poses(joints, None, None)[1]

    def in_odom(self, joints: FloatArray, position: FloatArray, orientation: FloatArray) -> tuple[Poses, Poses]:
        """The chest and the hand, for joints (m, n) [rad] and the pelvis' position (m, 3) [m], orientation (m, 4)."""
        chest, hand = self._poses(joints, position, orientation)
        return chest, hand.inside(chest)

    def _poses(
        self, joints: FloatArray, position: FloatArray | None, orientation: FloatArray | None
    ) -> tuple[Poses, Poses]:
        """The chest in odom, and the hand in the chest."""
        model, data = self._model, self._data
        m = len(joints)
        chest, hand = (Poses(np.empty((m, 3)), np.empty((m, 3, 3))) for _ in range(2))
        data.qpos[:7] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
        for i in range(m):
            if position is not None and orientation is not None:
                data.qpos[:3], data.qpos[3:7] = position[i], orientation[i]
            data.qpos[model.qpos] = joints[i, model.joint_indices]
            mujoco.mj_kinematics(model.mj, data)
            turn = data.xmat[self._chest].reshape(3, 3)
            chest.position[i], chest.rotation[i] = data.xpos[self._chest], turn
            hand.position[i] = turn.T @ (data.site_xpos[self._site] - data.xpos[self._chest])
            hand.rotation[i] = turn.T @ data.site_xmat[self._site].reshape(3, 3)
        return chest, hand


@dataclass(frozen=True)
class HandTrack:
    """Poses of a hand in an experiment; m samples.

    Attributes:
        time: (m,) robot time [s].
        behavior: (m,) of the Motion System.
        chest: in odom, by the estimate.
        reference: pose for the last goal, fixed base.
        command: pose for the VRC's set-points, fixed base.
        fixed: pose for the measured joints, fixed base.
        floating: pose for the measured joints and the estimated pelvis.
        motions: of this arm.
    """

    time: FloatArray
    behavior: np.typing.NDArray[np.str_]
    chest: Poses
    reference: Poses
    command: Poses
    fixed: Poses
    floating: Poses
    motions: list[Motion]

    @classmethod
    def of(cls, recording: Recording, timeline: Timeline, side: Side) -> HandTrack:
        """From a bag and its motions.

        Raises:
            BagError: the bag lacks a topic, or no motion moved that arm.
        """
        robot = recording.robot
        arm = robot.tables.group(f"{side}_arm")
        motions = [motion for motion in timeline.motions if set(motion.goal) & set(arm)]
        if not motions:
            raise BagError(f"{recording.bag.path}: no motion moved the {side} arm")
        recording.load(PROPRIOCEPTOR, MOTION_STATE, JOINT_SETPOINTS)
        states = recording.series(MOTION_STATE)
        measured_at, measured = recording.measured()
        begin = max(motions[0].start, measured_at[0], states.time[0])
        end = min(motions[-1].end, measured_at[-1], states.time[-1])
        time = np.arange(begin, end, 1.0 / RATE)
        if not len(time):
            raise BagError(f"{recording.bag.path}: {measured_at[0]:.1f}–{measured_at[-1]:.1f} s: without the motions")
        at = nearest(measured_at, time)
        joints = measured[at]
        told, wanted = joints.copy(), joints.copy()
        setpoints = recording.setpoints()
        for joint in arm:
            column = robot.index[joint]
            if joint in setpoints:
                told[:, column] = np.interp(time, *setpoints[joint])
            reference = timeline.reference(joint, time)
            wanted[:, column] = np.where(np.isnan(reference), joints[0, column], reference)
        hand = Hand(robot, side)
        pelvis = nearest(states.time, time)
        chest, floating = hand.in_odom(
            joints, states["pelvis_position_in_odom"][pelvis], states["pelvis_orientation_in_odom"][pelvis]
        )
        base = chest.first()
        return cls(
            time, states.strings("behavior")[pelvis], chest,
            hand.in_chest(wanted).inside(base), hand.in_chest(told).inside(base), hand.in_chest(joints).inside(base),
            floating, motions,
        )  # fmt: skip

    @property
    def command_error(self) -> PoseError:
        """Set-points minus goal, fixed base (figure 5.8)."""
        return PoseError.of(self.command, self.reference)

    @property
    def tracking_error(self) -> PoseError:
        """Measurement minus set-points, fixed base (figures 5.9, 5.14)."""
        return PoseError.of(self.fixed, self.command)

    @property
    def total_error(self) -> PoseError:
        """Measurement on the floating base minus goal (figures 5.11, 5.15)."""
        return PoseError.of(self.floating, self.reference)

    @property
    def base_error(self) -> PoseError:
        """Effect of the base's motion: floating minus fixed base (figures 5.12, 5.15)."""
        return PoseError.of(self.floating, self.fixed)

    def settled(self, motion: Motion) -> np.typing.NDArray[np.bool_]:
        """(m,) whether a sample is in the rest after a motion."""
        begin, end = motion.rest
        return (self.time >= begin) & (self.time <= end)
