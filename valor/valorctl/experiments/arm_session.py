"""The robot's right arm, and its neck if it has one, through predefined configurations, recorded (thesis 4.3.3).

Three experiments look at the same motions: the joints' signals, the hand's pose, and the time that commands take.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bifrost
from valor.analysis.timeline import Motion, Timeline
from valor.common.behaviors import ControlMode
from valor.common.messages import Proprioceptor
from valor.common.resources import robot_folder
from valor.common.topics import PROPRIOCEPTOR
from valor.robot.description import RobotDescription
from valor.valorctl import arm_motion, control_mode
from valor.valorctl.node import hear, join

if TYPE_CHECKING:
    from valor.valorctl.experiments.experiment import Run

MODE = ControlMode.STAND_MANIPULATE  # nothing holds the pelvis: the thesis' behavior
SPEED = 0.4  # fraction of the joint speed limits
SETTLE, QUICK_SETTLE = 1.5, 0.6  # after a motion, before the next begins [robot time, s]
SILENCE = 5.0  # of the devices, that ends the experiment [s]
REAL_ARMS = "drc_finals"  # of robot.yaml's actuators: backlash, no gravity compensation, a sick right wrist
ARM, NECK = "right_arm", "neck"
POSES = ("forward", "home", "side", "home", "up", "home", "fold", "home")
TURNED = 0.4  # the last joint of the wrist, away from home, which no pose turns by itself [rad]
LOOKS = (0.6, -0.6, 0.0)  # of the neck's yaw [rad]


def real_arms(run: Run) -> str | None:
    """The profile of the arms as they were on the real robot; None: this robot has none."""
    return REAL_ARMS if REAL_ARMS in RobotDescription.load(robot_folder(run.options.robot)).tables.actuators else None


def record(
    run: Run, bag: Path, robot: Path | None = None, actuators: str | None = None
) -> tuple[Timeline, RobotDescription]:
    """Bring a system up, move neck and arm, take it down; the bag is complete then.

    Args:
        run: the experiment.
        bag: where it is recorded.
        robot: its folder, if it is not the profile's robot.
        actuators: their profile, if it is not the command line's.

    Returns:
        What was asked and when, and the robot.

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
    timeline = Timeline(motions)
    timeline.save(bag.with_suffix(".json"))
    run.files += [bag, bag.with_suffix(".json")]
    return timeline, description


class _Devices:
    """What the robot measures now, and motions of it."""

    def __init__(self, robot: RobotDescription, measured: bifrost.Subscriber[Proprioceptor], run: Run) -> None:
        self._robot, self._measured, self._run = robot, measured, run

    def move(self, name: str, group: str, target: dict[str, float]) -> Motion:
        """One motion, and the rest after it."""
        self._run.progress.waiting(f"{group.replace('_', ' ')}: {name}")
        now = self._newest()
        start = dict(zip(self._robot.joints, now.joint_position.tolist(), strict=True))
        goal = {joint: float(target.get(joint, start[joint])) for joint in self._robot.tables.group(group)}
        duration = arm_motion.trajectory_duration(self._robot, start, goal, SPEED)
        # Errors are what is measured: none of them ends a motion.
        arm_motion.follow(self._run.instance, group, goal, duration, self._run.interruption.check, tolerant=True)
        settled = self._newest().time + round((QUICK_SETTLE if self._run.options.quick else SETTLE) * 1e9)
        while (now_time := self._newest().time) < settled:
            self._run.interruption.check()
        self._run.progress.done(f"{group.replace('_', ' ')}: {name} ({duration:.1f} s)")
        return Motion(name, 1e-9 * now.time, 1e-9 * now_time, goal)

    def _newest(self) -> Proprioceptor:
        self._measured.latest()
        return hear(PROPRIOCEPTOR, self._measured, SILENCE)
