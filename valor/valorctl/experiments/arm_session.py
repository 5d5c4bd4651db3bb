"""The robot's right arm, and its neck if it has one, through predefined configurations, recorded (thesis 4.3.3).

Three experiments look at the same motions: the joints' signals, the hand's pose, and the time that commands take.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import bifrost
from valor.analysis.timeline import Motion, Timeline
from valor.common.behaviors import ControlMode
from valor.common.messages import Proprioceptor
from valor.common.resources import robot_folder
from valor.common.topics import PROPRIOCEPTOR
from valor.robot.description import RobotDescription
from valor.valorctl import arm_motion, control_mode
from valor.valorctl.experiments import arbitrary_goals
from valor.valorctl.experiments.arbitrary_goals import Goal, HandLeader
from valor.valorctl.node import hear, join

if TYPE_CHECKING:
    from valor.valorctl.experiments.experiment import Run

Goals = Literal["none", "postures", "poses"]

MODE = ControlMode.STAND_MANIPULATE  # nothing holds the pelvis: the thesis' behavior
SPEED = 0.4  # fraction of the joint speed limits
SETTLE, QUICK_SETTLE = 1.5, 0.6  # after a motion, before the next begins [robot time, s]
SILENCE = 5.0  # of the devices, that ends the experiment [s]
REAL_ARMS = "drc_finals"  # of robot.yaml's actuators: backlash, no gravity compensation, a sick right wrist
UNCOMPENSATED = {"arm_servos": {"compensation": False}}  # nothing is done about the arms' friction and play
ARM, NECK = "right_arm", "neck"
POSES = ("forward", "home", "side", "home", "up", "home", "fold", "home")
TURNED = 0.4  # the last joint of the wrist, away from home, which no pose turns by itself [rad]
LOOKS = (0.6, -0.6, 0.0)  # of the neck's yaw [rad]


def real_arms(run: Run) -> str | None:
    """The profile of the arms as they were on the real robot; None: this robot has none."""
    return REAL_ARMS if REAL_ARMS in RobotDescription.load(robot_folder(run.options.robot)).tables.actuators else None


@dataclass(frozen=True)
class Session:
    """What was asked of a robot, and when.

    Attributes:
        robot: its description.
        presets: the neck's motions, and the arm's to its presets.
        arbitrary: the arm's to arbitrary goals.
        refused: names of those that a trajectory controller refused.
    """

    robot: RobotDescription
    presets: Timeline
    arbitrary: Timeline
    refused: list[str]


def record(
    run: Run, bag: Path, robot: Path | None = None, actuators: str | None = None, goals: Goals = "none"
) -> Session:
    """Bring a system up, move neck and arm, take it down; the bag is complete then.

    Args:
        run: the experiment.
        bag: where it is recorded.
        robot: its folder, if it is not the profile's robot.
        actuators: their profile, if it is not the command line's.
        goals: how arbitrary ones are asked for after the presets: by the arm's postures or by the hand's poses in odom.

    Raises:
        ValorError: a mode or motion was refused, or failed.
    """
    quick = run.options.quick
    motions: list[Motion] = []
    with run.system(bag=bag, robot=robot, actuators=actuators) as settings:
        description = RobotDescription.load(settings.robot)
        with join(run.instance, "experiment") as node:
            devices = _Devices(description, PROPRIOCEPTOR.subscriber(node), run)
            control_mode.enter(run.instance, MODE, run.interruption.check)
            if neck := description.tables.group(NECK):
                yaw, *others = neck
                for look in LOOKS[-1:] if quick else LOOKS:
                    target = {yaw: look, **dict.fromkeys(others, 0.0)}
                    motions.append(devices.move(f"look {look:+.1f} rad", NECK, target))
            presets = description.tables.arm_presets
            wrist = description.tables.group(ARM)[-1]
            poses = [name for name in POSES if "right" in presets.get(name, {})]
            for name in poses[:2] if quick else poses:
                target = presets[name]["right"] | ({} if name == "home" else {wrist: TURNED})
                motions.append(devices.move(name, ARM, target))
            asked, refused = _arbitrary(run, goals, devices, node)
    Timeline([*motions, *asked]).save(bag.with_suffix(".json"))
    run.files += [bag, bag.with_suffix(".json")]
    return Session(description, Timeline(motions), Timeline(asked), refused)


def _arbitrary(run: Run, goals: Goals, devices: _Devices, node: bifrost.Node) -> tuple[list[Motion], list[str]]:
    """Motions to arbitrary goals, and the names of those that were refused."""
    from valor.valorctl.ros_client import GoalRefusedError, RosClient

    motions: list[Motion] = []
    refused: list[str] = []
    if goals == "none":
        return motions, refused
    count = arbitrary_goals.QUICK if run.options.quick else arbitrary_goals.COUNT
    drawn = arbitrary_goals.drawn(devices.robot, run.options.seed, count)
    if goals == "poses":
        with RosClient(run.instance, run.interruption.check) as ros:
            leader = HandLeader(ros, node, devices.robot, run.instance.settings().frame_prefix)
            motions += [devices.lead(goal, leader) for goal in drawn]
        return motions, refused
    for goal in drawn:
        try:
            motions.append(devices.move(goal.name, ARM, goal.joints))
        except GoalRefusedError as error:
            refused.append(goal.name)
            run.progress.done(f"right arm: {goal.name}: refused: {error}")
    return motions, refused


class _Devices:
    """What the robot measures now, and motions of it."""

    def __init__(self, robot: RobotDescription, measured: bifrost.Subscriber[Proprioceptor], run: Run) -> None:
        self.robot, self._measured, self._run = robot, measured, run

    def move(self, name: str, group: str, target: dict[str, float]) -> Motion:
        """One motion, and the rest after it."""
        self._run.progress.waiting(f"{group.replace('_', ' ')}: {name}")
        now = self._newest()
        start = dict(zip(self.robot.joints, now.joint_position.tolist(), strict=True))
        goal = {joint: float(target.get(joint, start[joint])) for joint in self.robot.tables.group(group)}
        duration = arm_motion.trajectory_duration(self.robot, start, goal, SPEED)
        # Errors are what is measured: none of them ends a motion.
        arm_motion.follow(self._run.instance, group, goal, duration, self._run.interruption.check, tolerant=True)
        end = self._rest()
        self._run.progress.done(f"{group.replace('_', ' ')}: {name} ({duration:.1f} s)")
        return Motion(name, 1e-9 * now.time, end, goal)

    def lead(self, goal: Goal, leader: HandLeader) -> Motion:
        """The hand to a pose, and the rest after it."""
        self._run.progress.waiting(f"right hand: {goal.name}")
        began = self._newest().time
        said = leader.lead(goal)
        end = self._rest()
        told = f"{said.state.replace('_', ' ')}{f': {said.reason}' if said.reason else ''}"
        self._run.progress.done(f"right hand: {goal.name}: {told} ({end - 1e-9 * began:.1f} s)")
        return Motion(goal.name, 1e-9 * began, end, goal.joints)

    def _rest(self) -> float:
        """Let a motion settle; the robot time afterwards [s]."""
        settled = self._newest().time + round((QUICK_SETTLE if self._run.options.quick else SETTLE) * 1e9)
        while (now := self._newest().time) < settled:
            self._run.interruption.check()
        return 1e-9 * now

    def _newest(self) -> Proprioceptor:
        self._measured.latest()
        return hear(PROPRIOCEPTOR, self._measured, SILENCE)
