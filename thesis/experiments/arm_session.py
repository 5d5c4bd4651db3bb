"""Recorded motions of the right arm, and of the neck if there is one, to predefined configurations (thesis 4.3.3).

Used by the experiments on joint signals and on the pose of the hand.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import yaml

import bifrost
from thesis.analysis.pathway_taps import JOINT_STATES
from thesis.analysis.timeline import Motion, Timeline
from thesis.experiments import arbitrary_goals
from thesis.experiments.arbitrary_goals import HandGoalClient, HandTarget
from valor.analysis.reading.recording import recorded
from valor.common.behaviors import ControlMode
from valor.common.document import Document
from valor.common.errors import ValorError
from valor.common.instance import Recording
from valor.common.messages import Proprioceptor
from valor.common.resources import robot_folder
from valor.common.topics import (
    GROUND_TRUTH,
    HAND_GOAL,
    HAND_GOAL_STATUS,
    JOINT_SETPOINTS,
    MOTION_STATE,
    MOTOR,
    PROPRIOCEPTOR,
)
from valor.robot.description import RobotDescription
from valor.valorctl.drive import arm_motion, control_mode
from valor.valorctl.drive.node import join, next_message

if TYPE_CHECKING:
    from thesis.experiments.experiment import Run

Goals = Literal["none", "postures", "poses"]

MODE = ControlMode.STAND_MANIPULATE  # the pelvis is free, as in the thesis
SPEED = 0.4  # fraction of the joint speed limits
SETTLE, QUICK_SETTLE = 1.5, 0.6  # between two motions [robot time, s]
SILENCE = 5.0  # timeout of Proprioceptor [s]
REAL_ARMS = "drc_finals"  # of robot.yaml's actuators: backlash, no gravity compensation, a defective right wrist
UNCOMPENSATED = {"arm_servos": {"compensation": False}}  # friction and backlash of the arms are not compensated
PD = {"arm_control": "pd"}  # the thesis' control of the arms (5.3.1)
ARM, NECK = "right_arm", "neck"
POSES = ("forward", "home", "side", "home", "up", "home", "fold", "home")
TURNED = 0.4  # last joint of the wrist in poses other than home, which no preset rotates [rad]
TOPICS = (JOINT_STATES, arbitrary_goals.GOAL, *(recorded(topic) for topic in (
    PROPRIOCEPTOR, MOTOR, MOTION_STATE, JOINT_SETPOINTS, GROUND_TRUTH, HAND_GOAL, HAND_GOAL_STATUS,
)))  # fmt: skip
LOOKS = (0.6, -0.6, 0.0)  # of the neck's yaw [rad]


def real_arms(run: Run) -> str | None:
    """Actuator profile of the arms of the real robot; None if this robot has none."""
    return REAL_ARMS if REAL_ARMS in RobotDescription.load(robot_folder(run.options.robot)).tables.actuators else None


def variant(robot: str, changes: Mapping[str, Any], folder: Path) -> Path:
    """Copy a robot and change its tables.

    Args:
        robot: a name of robots/, or a folder.
        changes: values of robot.yaml by key; of a table, those to change.
        folder: of the copy; an existing one is replaced.

    Returns:
        The folder, for ``valorctl up --robot``.
    """
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(robot_folder(robot), folder)
    file = folder / "robot.yaml"
    tables: Any = Document.load(file).content
    for table, values in changes.items():
        tables[table] = tables.get(table, {}) | values if isinstance(values, Mapping) else values
    file.write_text(yaml.safe_dump(tables, sort_keys=False))
    return folder


@dataclass(frozen=True)
class Session:
    """Motions of a recorded session.

    Attributes:
        robot: its description.
        presets: motions of the neck, and of the arm to its presets.
        arbitrary: motions of the arm to arbitrary goals.
        refused: names of goals that the trajectory controller rejected.
    """

    robot: RobotDescription
    presets: Timeline
    arbitrary: Timeline
    refused: list[str]


def record(
    run: Run,
    bag: Path,
    robot: Path | None = None,
    actuators: str | None = None,
    goals: Goals = "none",
    *,
    controller: str = "",
) -> Session:
    """Start a system, move neck and arm, and stop it; the bag is then complete.

    Args:
        run: the experiment.
        bag: file of the recording.
        robot: its folder; default that of the command line.
        actuators: their profile; default that of the command line.
        goals: form of the arbitrary goals after the presets: none, postures of the arm, or poses of the hand in odom.
        controller: optional controller of the VRC to activate.

    Raises:
        ValorError: a mode or motion was rejected, or failed.
    """
    quick = run.options.quick
    motions: list[Motion] = []
    with run.system(bag=bag, robot=robot, actuators=actuators, recording=Recording(only=TOPICS)) as settings:
        description = RobotDescription.load(settings.robot)
        with join(run.instance, "experiment") as node:
            devices = _Devices(description, PROPRIOCEPTOR.subscriber(node), run)
            control_mode.enter(run.instance, MODE, run.interruption.check)
            if controller:
                _activate(run, controller)
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


def _activate(run: Run, controller: str) -> None:
    """Activate a controller of the VRC. Raises ValorError: it is rejected."""
    from controller_manager_msgs.srv import SwitchController

    from valor.valorctl.drive.ros_client import RosClient

    with RosClient(run.instance, run.interruption.check) as ros:
        client = ros.node.create_client(SwitchController, "controller_manager/switch_controller")
        ros.wait(client.service_is_ready, SILENCE, "no service switch_controller")
        future = client.call_async(SwitchController.Request(activate_controllers=[controller], strictness=2))
        ros.wait(future.done, SILENCE, "switch_controller: no response")
        if not (answer := future.result()).ok:
            raise ValorError(f"{controller} was not activated: {answer.message}")


def _arbitrary(run: Run, goals: Goals, devices: _Devices, node: bifrost.Node) -> tuple[list[Motion], list[str]]:
    """Move to arbitrary goals; returns the motions and the names of rejected goals."""
    from valor.valorctl.drive.ros_client import GoalRefusedError, RosClient

    motions: list[Motion] = []
    refused: list[str] = []
    if goals == "none":
        return motions, refused
    count = arbitrary_goals.QUICK if run.options.quick else arbitrary_goals.COUNT
    drawn = arbitrary_goals.drawn(devices.robot, run.options.seed, count)
    if goals == "poses":
        with RosClient(run.instance, run.interruption.check) as ros:
            client = HandGoalClient(ros, node, devices.robot, run.instance.settings().frame_prefix)
            motions += [devices.send_hand(goal, client) for goal in drawn]
        return motions, refused
    for goal in drawn:
        try:
            motions.append(devices.move(goal.name, ARM, goal.joints))
        except GoalRefusedError as error:
            refused.append(goal.name)
            run.progress.done(f"right arm: {goal.name}: refused: {error}")
    return motions, refused


class _Devices:
    """Motions of the robot, with robot times from Proprioceptor."""

    def __init__(self, robot: RobotDescription, measured: bifrost.Subscriber[Proprioceptor], run: Run) -> None:
        self.robot, self._measured, self._run = robot, measured, run

    def move(self, name: str, group: str, target: dict[str, float]) -> Motion:
        """Move a group of joints and wait for rest."""
        from valor.valorctl.drive.ros_client import RosClient

        self._run.progress.waiting(f"{group.replace('_', ' ')}: {name}")
        now = self._latest()
        start = dict(zip(self.robot.joints, now.joint_position.tolist(), strict=True))
        goal = {joint: float(target.get(joint, start[joint])) for joint in self.robot.tables.group(group)}
        duration = arm_motion.trajectory_duration(self.robot, start, goal, SPEED)
        # Errors are the subject: no tolerance ends a motion.
        with RosClient(self._run.instance, self._run.interruption.check) as ros:
            arm_motion.follow(ros, group, goal, duration, tolerant=True)
        end = self._rest()
        self._run.progress.done(f"{group.replace('_', ' ')}: {name} ({duration:.1f} s)")
        return Motion(name, 1e-9 * now.time, end, goal)

    def send_hand(self, goal: HandTarget, client: HandGoalClient) -> Motion:
        """Move the hand to a pose and wait for rest."""
        self._run.progress.waiting(f"right hand: {goal.name}")
        started = self._latest().time
        status = client.send(goal)
        end = self._rest()
        text = f"{status.state.replace('_', ' ')}{f': {status.reason}' if status.reason else ''}"
        self._run.progress.done(f"right hand: {goal.name}: {text} ({end - 1e-9 * started:.1f} s)")
        return Motion(goal.name, 1e-9 * started, end, goal.joints)

    def _rest(self) -> float:
        """Wait until a motion has settled; returns the robot time [s]."""
        settled = self._latest().time + round((QUICK_SETTLE if self._run.options.quick else SETTLE) * 1e9)
        while (now := self._latest().time) < settled:
            self._run.interruption.check()
        return 1e-9 * now

    def _latest(self) -> Proprioceptor:
        self._measured.latest()
        return next_message(PROPRIOCEPTOR, self._measured, SILENCE)
