"""Motions of arms and hands: from a preset of robot.yaml to a trajectory, and whether the limb got there."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.linking import robots_hosts
from valor.common.topics import PROPRIOCEPTOR
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription
from valor.valorctl.node import hear, join

if TYPE_CHECKING:
    from valor.valorctl.ros_client import RosClient

Side = Literal["left", "right"]
SIDES: tuple[Side, ...] = get_args(Side)
Limb = Literal["arm", "hand"]

SHORTEST = 1.0  # [s]
# A quintic from rest to rest is at its middle 15/8 as fast as on average.
_QUINTIC_PEAK = 15.0 / 8.0
_RESULT_MARGIN = 30.0  # on top of the motion itself, should simulated time run slowly [s]
_SLOWEST_CLOCK = 0.1  # real-time factor below which we give up
_SETTLE_TIMEOUT = 2.0  # [s]


@dataclass(frozen=True)
class LimbMotion:
    """What became of a motion."""

    duration: float  # of the trajectory [robot time, s]
    worst_joint: str
    worst_error: float  # measured minus wanted, at the end [rad]
    tolerance: float  # [rad]

    @property
    def arrived(self) -> bool:
        """Whether every joint is within the tolerance."""
        return abs(self.worst_error) <= self.tolerance

    def describe(self) -> str:
        """One line."""
        return f"largest joint error {self.worst_error:+.4f} rad at {self.worst_joint} (limit {self.tolerance:g} rad)"


def require_limbs(robot: RobotDescription, what: str, *groups: str) -> None:
    """Refuse what a robot has not the limbs for.

    Args:
        robot: its description.
        what: is wanted of it.
        groups: of robot.yaml that it takes.

    Raises:
        ValorError: a group has no joints; says which limb the robot lacks.
    """
    lacking = [group.replace("_", " ") for group in groups if not robot.tables.group(group)]
    if lacking:
        raise ValorError(f"{what}: {robot.name} has no {' and no '.join(lacking)} that moves")


def preset(robot: RobotDescription, side: Side, limb: Limb, name: str) -> dict[str, float]:
    """Joint positions of a preset [rad].

    Raises:
        ValorError: the robot has no such limb, or no such preset for it; lists the known.
    """
    require_limbs(robot, f"preset {name!r}", f"{side}_{limb}")
    presets = {"arm": robot.tables.arm_presets, "hand": robot.tables.hand_presets}[limb]
    known = sorted(each for each, sides in presets.items() if side in sides)
    if name not in known:
        raise ValorError(f"preset {name!r}: {robot.name} knows for its {side} {limb}: {', '.join(known) or 'none'}")
    return dict(presets[name][side])


def trajectory_duration(
    robot: RobotDescription, start: Mapping[str, float], goal: Mapping[str, float], speed: float
) -> float:
    """How long a quintic from rest to rest must take so that no joint exceeds ``speed`` times its limit [s]."""
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
    """Move an arm or a hand to a preset by way of the VRC's trajectory controller, and measure where it came to rest.

    Args:
        instance: must be up.
        side: left or right.
        limb: arm or hand.
        name: of the preset.
        speed: fraction of the joint speed limits, at most 1.
        tolerance: for the final error of each joint [rad].
        check: called while waiting; may raise to give up, which cancels the motion.

    Raises:
        ValorError: unknown preset, goal refused, or the motion failed; carries the controller's words.
    """  # fmt: skip
    settings = instance.settings()
    robot = RobotDescription.load(settings.robot)
    wanted = preset(robot, side, limb, name)
    with _measuring(instance, robot) as positions:
        start = positions()
        # The controller wants all joints of the limb; those that the preset leaves out stay.
        goal = {joint: wanted.get(joint, start[joint]) for joint in robot.tables.group(f"{side}_{limb}")}
        duration = trajectory_duration(robot, start, goal, speed)
        follow(instance, f"{side}_{limb}", goal, duration, check)
        worst, error = _final_error(positions, goal, tolerance, check)
    return LimbMotion(duration, worst, error, tolerance)


def follow(
    instance: Instance,
    group: str,
    goal: Mapping[str, float],
    duration: float,
    check: Callable[[], None] = lambda: None,
    *,
    tolerant: bool = False,
) -> None:
    """Bring the joints of a group to rest at a goal by way of the VRC's trajectory controller, and wait for the result.

    Args:
        instance: must be up.
        group: of robot.yaml, such as ``left_arm``.
        goal: final position of every joint of the group [rad].
        duration: of the motion [robot time, s].
        check: called while waiting; may raise to give up, which cancels the motion.
        tolerant: no joint's error, on the way or at the goal, ends the motion.

    Raises:
        ValorError: the goal was refused, or the motion failed; carries the controller's words.
    """
    from valor.valorctl.ros_client import RosClient

    with RosClient(instance, check) as ros:
        follow_by(ros, group, goal, duration, tolerant=tolerant)


def follow_by(
    ros: RosClient, group: str, goal: Mapping[str, float], duration: float, *, tolerant: bool = False
) -> None:
    """As ``follow``, with a node that is there."""
    from builtin_interfaces.msg import Duration
    from control_msgs.action import FollowJointTrajectory
    from control_msgs.msg import JointTolerance
    from trajectory_msgs.msg import JointTrajectoryPoint

    from valor.valorctl.ros_client import GoalRefusedError

    message = FollowJointTrajectory.Goal()
    message.trajectory.joint_names = list(goal)
    whole, part = divmod(duration, 1.0)
    message.trajectory.points = [
        JointTrajectoryPoint(
            positions=list(goal.values()),
            velocities=[0.0] * len(goal),
            accelerations=[0.0] * len(goal),
            time_from_start=Duration(sec=int(whole), nanosec=int(part * 1e9)),
        )
    ]
    if tolerant:
        unchecked = [JointTolerance(name=joint, position=-1.0, velocity=-1.0, acceleration=-1.0) for joint in goal]
        message.path_tolerance = message.goal_tolerance = unchecked
    action = f"trajectory_controllers/{group}_traj_controller/follow_joint_trajectory"
    try:
        result = ros.call_action(FollowJointTrajectory, action, message, duration / _SLOWEST_CLOCK + _RESULT_MARGIN)
    except GoalRefusedError:
        raise GoalRefusedError(f"{ros.diagnosis('last trajectory refused') or action} (goal refused)") from None
    if result.error_code != FollowJointTrajectory.Result.SUCCESSFUL:
        raise ValorError(f"{group}_traj_controller: error {result.error_code}: {result.error_string}")


@contextmanager
def _measuring(instance: Instance, robot: RobotDescription) -> Iterator[Callable[[], dict[str, float]]]:
    """What waits for the next joint positions; on the operator's side of a link for those that come through it."""
    if robots_hosts(instance.settings()):
        from valor.valorctl import beyond_link

        with beyond_link.joints(instance) as positions:
            yield positions
        return
    with join(instance) as node:
        measured = PROPRIOCEPTOR.subscriber(node)
        yield lambda: dict(zip(robot.joints, hear(PROPRIOCEPTOR, measured, 2.0).joint_position.tolist(), strict=True))


def _final_error(
    positions: Callable[[], dict[str, float]],
    goal: Mapping[str, float],
    tolerance: float,
    check: Callable[[], None],
) -> tuple[str, float]:
    """The joint that is farthest off, once all are within tolerance or had their time to settle."""
    deadline = time.monotonic() + _SETTLE_TIMEOUT
    while True:
        check()
        now = positions()
        errors = {name: now[name] - wanted for name, wanted in goal.items()}
        worst = max(errors, key=lambda name: abs(errors[name]))
        if abs(errors[worst]) <= tolerance or time.monotonic() > deadline:
            return worst, errors[worst]
