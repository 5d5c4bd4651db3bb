"""Motions of arms and hands to presets of robot.yaml, by the VRC's trajectory controllers."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.topics import PROPRIOCEPTOR
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription
from valor.ros.limbs import LAST_TRAJECTORY_REJECTED
from valor.valorctl.drive.node import join, next_message

if TYPE_CHECKING:
    from valor.valorctl.drive.ros_client import RosClient

Side = Literal["left", "right"]
SIDES: tuple[Side, ...] = get_args(Side)
Limb = Literal["arm", "hand"]

SHORTEST = 1.0  # [s]
# A quintic from rest to rest is at its middle 15/8 as fast as on average.
_QUINTIC_PEAK = 15.0 / 8.0
_RESULT_MARGIN = 30.0  # in addition to the motion [s]
_SLOWEST_CLOCK = 0.1  # real-time factor below which a motion times out
_SETTLE_TIMEOUT = 2.0  # [s]


@dataclass(frozen=True)
class LimbMotion:
    """Result of a motion."""

    duration: float  # of the trajectory [robot time, s]
    worst_joint: str
    worst_error: float  # measured minus target, at the end [rad]
    tolerance: float  # [rad]

    @property
    def arrived(self) -> bool:
        """True if every joint is within the tolerance."""
        return abs(self.worst_error) <= self.tolerance

    def describe(self) -> str:
        """One line."""
        return f"largest joint error {self.worst_error:+.4f} rad at {self.worst_joint} (limit {self.tolerance:g} rad)"


def require_limbs(robot: RobotDescription, what: str, *groups: str) -> None:
    """Raise ``ValorError`` if one of the groups of robot.yaml has no joints; ``what`` needs them."""
    lacking = [group.replace("_", " ") for group in groups if not robot.tables.group(group)]
    if lacking:
        raise ValorError(f"{what}: {robot.name} has no {' and no '.join(lacking)} that moves")


def preset(robot: RobotDescription, side: Side, limb: Limb, name: str) -> dict[str, float]:
    """Joint positions of a preset [rad]; raises ``ValorError`` with the presets if the robot does not have it."""
    require_limbs(robot, f"preset {name!r}", f"{side}_{limb}")
    presets = {"arm": robot.tables.arm_presets, "hand": robot.tables.hand_presets}[limb]
    known = sorted(each for each, sides in presets.items() if side in sides)
    if name not in known:
        raise ValorError(f"preset {name!r}: expected one of its {side} {limb}: {', '.join(known) or 'none'}")
    return dict(presets[name][side])


def trajectory_duration(
    robot: RobotDescription, start: Mapping[str, float], goal: Mapping[str, float], speed: float
) -> float:
    """Duration of a quintic from rest to rest in which no joint exceeds ``speed`` times its limit [s]."""
    limits = CommandedLimits.of_joints(robot)
    slowest = max(
        abs(goal[name] - start[name]) * _QUINTIC_PEAK / (speed * limits.velocity[robot.index[name]]) for name in goal
    )
    return max(SHORTEST, float(slowest))


def move_limb(
    instance: Instance,
    side: Side,
    limb: Limb,
    name: str,
    *,
    speed: float,
    tolerance: float,
    check: Callable[[], None] = lambda: None,
) -> LimbMotion:
    """Move an arm or a hand to a preset and measure its final error.

    ``speed``: share of the joint speed limits, at most 1; ``tolerance``: final error of each joint, at most [rad].
    ``check`` is called while waiting and may raise, which cancels the motion.

    Raises ``ValorError``: unknown preset, goal rejected, or the motion failed, with the controller's reason.
    """
    from valor.valorctl.drive.ros_client import RosClient

    robot = RobotDescription.load(instance.settings().robot)
    wanted = preset(robot, side, limb, name)
    with join(instance) as node, RosClient(instance, check) as ros:
        measured = PROPRIOCEPTOR.subscriber(node)

        def positions() -> dict[str, float]:
            return dict(
                zip(robot.joints, next_message(PROPRIOCEPTOR, measured, 2.0).joint_position.tolist(), strict=True)
            )

        start = positions()
        # The controller requires all joints of the limb; those without a preset keep their position.
        goal = {joint: wanted.get(joint, start[joint]) for joint in robot.tables.group(f"{side}_{limb}")}
        duration = trajectory_duration(robot, start, goal, speed)
        follow(ros, f"{side}_{limb}", goal, duration)
        deadline = time.monotonic() + _SETTLE_TIMEOUT
        while True:
            check()
            now = positions()
            worst = max(goal, key=lambda joint: abs(now[joint] - goal[joint]))
            error = now[worst] - goal[worst]
            if abs(error) <= tolerance or time.monotonic() > deadline:
                return LimbMotion(duration, worst, error, tolerance)


def follow(ros: RosClient, group: str, goal: Mapping[str, float], duration: float, *, tolerant: bool = False) -> None:
    """Bring a group of robot.yaml to rest at a goal [rad] in a duration [robot time, s], and wait for the result.

    ``tolerant``: tracking errors do not end the motion. Raises ``ValorError`` with the controller's reason.
    """
    from builtin_interfaces.msg import Duration
    from control_msgs.action import FollowJointTrajectory
    from control_msgs.msg import JointTolerance
    from trajectory_msgs.msg import JointTrajectoryPoint

    from valor.valorctl.drive.ros_client import GoalRefusedError

    message = FollowJointTrajectory.Goal()
    message.trajectory.joint_names = list(goal)
    seconds, fraction = divmod(duration, 1.0)
    message.trajectory.points = [
        JointTrajectoryPoint(
            positions=list(goal.values()),
            velocities=[0.0] * len(goal),
            accelerations=[0.0] * len(goal),
            time_from_start=Duration(sec=int(seconds), nanosec=int(fraction * 1e9)),
        )
    ]
    if tolerant:
        unchecked = [JointTolerance(name=joint, position=-1.0, velocity=-1.0, acceleration=-1.0) for joint in goal]
        message.path_tolerance = message.goal_tolerance = unchecked
    action = f"trajectory_controllers/{group}_traj_controller/follow_joint_trajectory"
    try:
        result = ros.call_action(FollowJointTrajectory, action, message, duration / _SLOWEST_CLOCK + _RESULT_MARGIN)
    except GoalRefusedError:
        raise GoalRefusedError(f"{ros.diagnosis(LAST_TRAJECTORY_REJECTED) or action} (goal rejected)") from None
    if result.error_code != FollowJointTrajectory.Result.SUCCESSFUL:
        raise ValorError(f"{group}_traj_controller: error {result.error_code}: {result.error_string}")
