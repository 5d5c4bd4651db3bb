"""Arbitrary goals of the right arm, in front and behind, drawn from a seed; in the thesis MoveIt planned them (4.3.3).

Each goal is the end posture of a trajectory, or the pose of the hand in this posture, with the base where it is when
the first goal is sent.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import cycle, islice
from typing import TYPE_CHECKING

import mujoco
import numpy as np

import bifrost
from thesis.analysis.end_effector import Hand
from thesis.experiments.arm_goals import ArmGoals
from valor.common.arrays import FloatArray
from valor.common.messages import HandGoalStatus
from valor.common.topics import HAND_GOAL_STATUS, MOTION_STATE, PROPRIOCEPTOR
from valor.robot.description import RobotDescription
from valor.robot.tables import Side
from valor.ros.limbs import HANDS
from valor.valorctl.drive.node import next_message

if TYPE_CHECKING:
    from valor.valorctl.drive.ros_client import RosClient

SIDE: Side = "right"
HAND = 1  # as messages count them
COUNT, QUICK = 16, 10
GOAL = f"/flor/{HANDS[HAND]}/goal_pose"  # for VRC and recorder
WHERE = ("ahead", "behind")
MOVING, REACHED, OUT_OF_REACH = "moving", "reached", "out_of_reach"
PATIENCE = 20.0  # timeout of the acceptance of a goal [s]
DISCOVERY = 60.0  # until VRC and recorder subscribe [s]
LONGEST = 120.0  # timeout of its result; the clock may be slow [s]


@dataclass(frozen=True)
class HandTarget:
    """One goal.

    Attributes:
        name: number, and whether it is ahead of the base or behind it.
        joints: of the arm [rad].
    """

    name: str
    joints: dict[str, float]


def drawn(robot: RobotDescription, seed: int, count: int) -> list[HandTarget]:
    """Draw goals alternately ahead and behind, each reachable from the previous one by a straight joint motion.

    Raises:
        ValorError: no such goals exist.
    """
    goals, arm = ArmGoals(robot, seed), robot.group_indices(f"{SIDE}_arm")
    posture = robot.nominal_posture.copy()
    for name, angle in robot.tables.arm_presets.get("home", {}).get(SIDE, {}).items():
        posture[robot.index[name]] = angle
    made = []
    for i, where in enumerate(islice(cycle(WHERE), count), 1):
        posture[arm] = goals.draw(SIDE, posture, ahead=where == WHERE[0], straight=True).joints
        made.append(HandTarget(f"{i} {where}", {robot.joints[k]: float(posture[k]) for k in arm}))
    return made


class HandGoalClient:
    """Client of hand goals in odom, over ROS."""

    def __init__(self, ros: RosClient, node: bifrost.Node, robot: RobotDescription, prefix: str) -> None:
        """Store the pose of the base.

        Args:
            ros: client that sends goals.
            node: that receives states.
            robot: its description.
            prefix: of the frame names.

        Raises:
            ValorError: no state of the base is received.
        """
        from geometry_msgs.msg import PoseStamped

        self._ros, self._robot, self._frame = ros, robot, f"{prefix}odom"
        state = next_message(MOTION_STATE, MOTION_STATE.subscriber(node), PATIENCE)
        self._joints = next_message(PROPRIOCEPTOR, PROPRIOCEPTOR.subscriber(node), PATIENCE).joint_position
        self._pelvis = state.pelvis_position_in_odom[None], state.pelvis_orientation_in_odom[None]
        self._hand = Hand(robot, SIDE)
        self._statuses = HAND_GOAL_STATUS.subscriber(node, queue=200)
        # Subscribers: VRC and recorder.
        self._goals = ros.publisher(PoseStamped, GOAL.lstrip("/"), 2, DISCOVERY)
        self._status: HandGoalStatus | None = None

    def send(self, goal: HandTarget) -> HandGoalStatus:
        """Send a goal, wait for its result and return its last status.

        Raises:
            ValorError: the goal is not accepted, or has no result in time.
        """
        from geometry_msgs.msg import PoseStamped

        message = PoseStamped()
        message.header.frame_id = self._frame
        position, rotation = self._pose(goal)
        message.pose.position.x, message.pose.position.y, message.pose.position.z = position.tolist()
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, rotation.ravel())
        to = message.pose.orientation
        to.w, to.x, to.y, to.z = quaternion.tolist()
        self._statuses.drain()
        self._goals.publish(message)
        self._ros.wait(lambda: self._becomes(MOVING), PATIENCE, f"goal {goal.name} of the hand is not accepted")
        self._ros.wait(lambda: self._becomes(REACHED, OUT_OF_REACH), LONGEST, f"goal {goal.name} has no result")
        assert self._status is not None
        return self._status

    def _pose(self, goal: HandTarget) -> tuple[FloatArray, FloatArray]:
        """Pose of the hand in odom: position (3,) [m], rotation (3, 3)."""
        joints = self._joints.copy()
        joints[self._robot.group_indices(f"{SIDE}_arm")] = list(goal.joints.values())
        _, hand = self._hand.in_odom(joints[None], *self._pelvis)
        return hand.position[0], hand.rotation[0]

    def _becomes(self, *states: str) -> bool:
        """Return whether the latest status of the hand is one of some states."""
        for received in self._statuses.drain():
            if received.message.hand == HAND:
                self._status = received.message
                if self._status.state in states:
                    return True
        return False
