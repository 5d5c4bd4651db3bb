"""Who works with a robot while it is measured: an operator's client and a planner, each a process of its own.

``python -m valor.valorctl.experiments.beside operator`` hears what an operator is shown, every state at its full rate;
``planner`` plans ways of an arm and of the feet from where the robot is, again and again. Neither moves it. Each says
``ready`` when it has heard the robot, and ends with SIGTERM or with who started it.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from valor.common.errors import ValorError, require_one_of
from valor.common.instance import Instance
from valor.robot.arm_goals import ArmGoals
from valor.robot.description import RobotDescription
from valor.robot.step_planner import plan_to
from valor.ros.limbs import FEET, WRENCH
from valor.valorctl.interruption import InterruptedBySignalError, Interruption

if TYPE_CHECKING:
    from valor.valorctl.experiments.experiment import Run
    from valor.valorctl.ros_client import RosClient

PATIENCE = 60.0  # until each has heard the robot [s]
ENDING = 10.0  # of each, when it is told to [s]
PLANS, PERIOD = 20, 0.5  # ways at a time, and from one time to the next [s]
FARTHEST = 3.0  # of the feet's goals [m]
READY = "ready"
_JOINTS = "joint_states"


def operator(ros: RosClient, instance: Instance) -> None:
    """Hear joints, transforms, forces, and what the robot says of itself."""
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import WrenchStamped
    from nav_msgs.msg import Odometry
    from sensor_msgs.msg import Imu, JointState
    from tf2_msgs.msg import TFMessage
    from valor_msgs.msg import MotionState

    heard: set[str] = set()
    topics = [(_JOINTS, JointState), ("tf", TFMessage), ("imu/data", Imu), ("odom", Odometry),
              ("diagnostics", DiagnosticArray), ("flor/controller/motion_state", MotionState),
              *((WRENCH.format(limb), WrenchStamped) for limb in FEET)]  # fmt: skip
    for topic, kind in topics:
        ros.subscribe(kind, topic, partial(_note, heard, topic), 10)
    ros.wait(lambda: len(heard) == len(topics), PATIENCE, f"not all of {', '.join(topic for topic, _ in topics)}")
    _say_ready()
    ros.wait(lambda: False, float("inf"), "")


def planner(ros: RosClient, instance: Instance) -> None:
    """Plan ways of the right arm on which nothing touches, and steps."""
    from sensor_msgs.msg import JointState

    robot = RobotDescription.load(instance.settings().robot)
    goals, rng = ArmGoals(robot, instance.settings().seed), np.random.default_rng(instance.settings().seed)
    posture = robot.nominal_posture.copy()
    heard: list[int] = []

    def hear(message: JointState) -> None:
        for name, angle in zip(message.name, message.position, strict=True):
            posture[robot.index[name]] = angle
        heard[:] = [1]

    ros.subscribe(JointState, _JOINTS, hear, 1)
    ros.wait(lambda: bool(heard), PATIENCE, f"no {_JOINTS}")
    _say_ready()
    steps, walking = robot.tables.footsteps, robot.tables.walking
    while True:
        due = time.monotonic() + PERIOD
        for _ in range(PLANS):
            if robot.tables.group("right_arm"):
                goals.draw("right", posture, straight=True)
            if steps is not None:
                x, y = rng.uniform(-FARTHEST, FARTHEST, 2) / np.sqrt(2.0)
                with contextlib.suppress(ValorError):  # farther than a plan of this robot may go
                    plan_to((x, y, rng.uniform(-np.pi, np.pi)), steps, walking)
        ros.wait(lambda due=due: time.monotonic() >= due, float("inf"), "")  # type: ignore[misc]


ROLES: dict[str, Callable[[RosClient, Instance], None]] = {"operator": operator, "planner": planner}


@contextlib.contextmanager
def working(run: Run) -> Iterator[dict[str, int]]:
    """All of them, beside a system that is up.

    Yields:
        Their process ids, by role.

    Raises:
        ValorError: one did not hear the robot in time, or ended before what is inside did; names it.
    """
    environment = os.environ | run.instance.environment()
    began: dict[str, subprocess.Popen[str]] = {}
    try:
        for role in ROLES:
            command = [sys.executable, "-m", __name__, role]
            began[role] = subprocess.Popen(
                command, env=environment, stdout=subprocess.PIPE, text=True, start_new_session=True
            )
        for role, process in began.items():
            run.progress.waiting(f"{role} beside it")
            assert process.stdout is not None
            if process.stdout.readline().strip() != READY:  # it ends by itself when it has waited too long
                raise ValorError(f"{role}, beside the robot: ended before it had heard it")
        yield {role: process.pid for role, process in began.items()}
        if ended := [role for role, process in began.items() if process.poll() is not None]:
            raise ValorError(f"{', '.join(ended)}, beside the robot: ended while it was measured")
    finally:
        for process in began.values():
            process.terminate()
        for process in began.values():
            try:
                process.wait(ENDING)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            if process.stdout is not None:
                process.stdout.close()


def _note(heard: set[str], topic: str, _message: Any) -> None:
    heard.add(topic)


def _say_ready() -> None:
    print(READY, flush=True)


def main(role: str) -> int:
    """Work until told to end; returns the exit status."""
    from valor.valorctl.ros_client import RosClient

    instance, parent = Instance.from_environment(), os.getppid()
    with Interruption() as interruption:

        def check() -> None:
            interruption.check()
            if os.getppid() != parent:
                raise ValorError("who started it has ended")

        try:
            require_one_of("role", role, ROLES)
            with RosClient(instance, check) as ros:
                ROLES[role](ros, instance)
        except InterruptedBySignalError:
            return 0
        except ValorError as error:
            print(f"{role}: {error}", file=sys.stderr)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
