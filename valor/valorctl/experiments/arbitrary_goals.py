"""Arbitrary goals of the right arm, in front and behind, drawn from a seed; the thesis had MoveIt plan them (4.3.3).

Either each is a posture that a trajectory goes to, or the pose that the hand has there on the base as it stands when
the first of them is sent.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import cycle, islice
from typing import TYPE_CHECKING

import mujoco
import numpy as np

import bifrost
from valor.analysis.end_effector import Hand
from valor.common.arrays import FloatArray
from valor.common.messages import HandGoalStatus
from valor.common.topics import HAND_GOAL_STATUS, MOTION_STATE, PROPRIOCEPTOR
from valor.robot.arm_goals import ArmGoals
from valor.robot.description import RobotDescription
from valor.robot.tables import Side
from valor.ros.limbs import HANDS
from valor.valorctl.node import hear

if TYPE_CHECKING:
    from valor.valorctl.ros_client import RosClient

SIDE: Side = "right"
HAND = 1  # as messages count them
COUNT, QUICK = 30, 10
WHERE = ("ahead", "behind")
MOVING, REACHED, OUT_OF_REACH = "moving", "reached", "out_of_reach"
PATIENCE = 20.0  # until a goal is taken [s]
LONGEST = 120.0  # until it has an end: the clock may be slow [s]


@dataclass(frozen=True)
class Goal:
    """One of them.

    Attributes:
        name: its number, and whether it is ahead of the base or behind it.
        joints: of the arm [rad].
    """

    name: str
    joints: dict[str, float]


def drawn(robot: RobotDescription, seed: int, count: int) -> list[Goal]:
    """Goals ahead and behind in turn; from home, and from each to the next, joints may go straight.

    Raises:
        ValorError: the robot has no such goals.
    """
    goals, arm = ArmGoals(robot, seed), robot.group_indices(f"{SIDE}_arm")
    posture = robot.nominal_posture.copy()
    for name, angle in robot.tables.arm_presets.get("home", {}).get(SIDE, {}).items():
        posture[robot.index[name]] = angle
    made = []
    for i, where in enumerate(islice(cycle(WHERE), count), 1):
        posture[arm] = goals.draw(SIDE, posture, ahead=where == WHERE[0], straight=True).joints
        made.append(Goal(f"{i} {where}", {robot.joints[k]: float(posture[k]) for k in arm}))
    return made


class HandLeader:
    """Leads the hand to poses in odom, by way of ROS."""

    def __init__(self, ros: RosClient, node: bifrost.Node, robot: RobotDescription, prefix: str) -> None:
        """Note where the base is.

        Args:
            ros: to send with.
            node: to hear with.
            robot: its description.
            prefix: of the frames' names.

        Raises:
            ValorError: nobody tells where the base is, or takes goals.
        """
        from geometry_msgs.msg import PoseStamped

        self._ros, self._robot, self._frame = ros, robot, f"{prefix}odom"
        state = hear(MOTION_STATE, MOTION_STATE.subscriber(node), PATIENCE)
        self._joints = hear(PROPRIOCEPTOR, PROPRIOCEPTOR.subscriber(node), PATIENCE).joint_position
        self._pelvis = state.pelvis_position_in_odom[None], state.pelvis_orientation_in_odom[None]
        self._hand = Hand(robot, SIDE)
        self._heard = HAND_GOAL_STATUS.subscriber(node, queue=200)
        # The VRC listens, and the recorder.
        self._goals = ros.publisher(PoseStamped, f"flor/{HANDS[HAND]}/goal_pose", 2)
        self._status: HandGoalStatus | None = None

    def lead(self, goal: Goal) -> HandGoalStatus:
        """Send a goal, and return what is said of it when the hand has come to its end.

        Raises:
            ValorError: it is not taken, or comes to no end.
        """
        from geometry_msgs.msg import PoseStamped

        message = PoseStamped()
        message.header.frame_id = self._frame
        place, turn = self._pose(goal)
        message.pose.position.x, message.pose.position.y, message.pose.position.z = place.tolist()
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, turn.ravel())
        to = message.pose.orientation
        to.w, to.x, to.y, to.z = quaternion.tolist()
        self._heard.drain()
        self._goals.publish(message)
        self._ros.wait(lambda: self._becomes(MOVING), PATIENCE, f"goal {goal.name} of the hand is not taken")
        self._ros.wait(lambda: self._becomes(REACHED, OUT_OF_REACH), LONGEST, f"goal {goal.name} has no end")
        assert self._status is not None
        return self._status

    def _pose(self, goal: Goal) -> tuple[FloatArray, FloatArray]:
        """Of the hand in odom: place (3,) [m], rotation (3, 3)."""
        joints = self._joints.copy()
        joints[self._robot.group_indices(f"{SIDE}_arm")] = list(goal.joints.values())
        _, hand = self._hand.in_odom(joints[None], *self._pelvis)
        return hand.position[0], hand.rotation[0]

    def _becomes(self, *states: str) -> bool:
        """Whether the hand is said to be in one of some states."""
        for received in self._heard.drain():
            if received.message.hand == HAND:
                self._status = received.message
                if self._status.state in states:
                    return True
        return False
