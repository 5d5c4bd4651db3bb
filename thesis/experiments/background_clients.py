"""Clients that work with a robot while its processes are measured: an operator's client and a planner, a process each.

``python -m thesis.experiments.background_clients operator`` receives what an operator's page shows, every state at its
full rate; ``planner`` plans motions of an arm and of the feet from the robot's present state, repeatedly. Neither moves
the robot. Each prints ``ready`` after the first messages, and ends with SIGTERM or with its parent.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import psutil

from thesis.experiments.arm_goals import ArmGoals
from valor.common.errors import ValorError, require_one_of
from valor.common.instance import Instance
from valor.common.viewing import page_port, scene_port, url
from valor.robot.description import RobotDescription
from valor.robot.step_plan import plan_to
from valor.ros.limbs import FEET, WRENCH
from valor.valorctl.terminal.console import InterruptedBySignalError, Interruption

if TYPE_CHECKING:
    from thesis.experiments.experiment import Run
    from valor.valorctl.drive.ros_client import RosClient

PATIENCE = 60.0  # timeout of the first messages [s]
ENDING = 10.0  # timeout of the end after SIGTERM [s]
PLANS, PERIOD = 20, 0.5  # plans per cycle; period of the cycles [s]
FARTHEST = 3.0  # maximum distance of the goals of the feet [m]
READY = "ready"
BROWSER = "chromium"
NICE, OPENING = 10, 150.0  # its priority, as if it were on another computer; timeout of its view [s]
# Of a computer without a graphics card; a small window, for another computer draws in reality.
_ARGUMENTS = ("--headless", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--window-size=640,400",
              "--enable-unsafe-swiftshader", "--disable-background-networking", "--no-first-run")  # fmt: skip
_JOINTS = "joint_states"


def operator(ros: RosClient, instance: Instance) -> None:
    """Subscribe to joints, transforms, forces and states."""
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import WrenchStamped
    from nav_msgs.msg import Odometry
    from sensor_msgs.msg import Imu, JointState
    from tf2_msgs.msg import TFMessage
    from valor_msgs.msg import MotionState

    received: set[str] = set()
    topics = [(_JOINTS, JointState), ("tf", TFMessage), ("imu/data", Imu), ("odom", Odometry),
              ("diagnostics", DiagnosticArray), ("flor/controller/motion_state", MotionState),
              *((WRENCH.format(limb), WrenchStamped) for limb in FEET)]  # fmt: skip
    for topic, kind in topics:
        ros.subscribe(kind, topic, partial(_note, received, topic), 10)
    ros.wait(lambda: len(received) == len(topics), PATIENCE, f"not all of {', '.join(topic for topic, _ in topics)}")
    _say_ready()
    ros.wait(lambda: False, float("inf"), "")


def planner(ros: RosClient, instance: Instance) -> None:
    """Plan collision-free motions of the right arm, and steps."""
    from sensor_msgs.msg import JointState

    robot = RobotDescription.load(instance.settings().robot)
    goals, rng = ArmGoals(robot, instance.settings().seed), np.random.default_rng(instance.settings().seed)
    posture = robot.nominal_posture.copy()
    received: list[int] = []

    def hear(message: JointState) -> None:
        for name, angle in zip(message.name, message.position, strict=True):
            posture[robot.index[name]] = angle
        received[:] = [1]

    ros.subscribe(JointState, _JOINTS, hear, 1)
    ros.wait(lambda: bool(received), PATIENCE, f"no {_JOINTS}")
    _say_ready()
    steps, walking = robot.tables.footsteps, robot.tables.walking
    while True:
        due = time.monotonic() + PERIOD
        for _ in range(PLANS):
            if robot.tables.group("right_arm"):
                goals.draw("right", posture, straight=True)
            if steps is not None:
                x, y = rng.uniform(-FARTHEST, FARTHEST, 2) / np.sqrt(2.0)
                with contextlib.suppress(ValorError):  # beyond the longest plan of this robot
                    plan_to((x, y, rng.uniform(-np.pi, np.pi)), steps, walking)
        ros.wait(lambda due=due: time.monotonic() >= due, float("inf"), "")  # type: ignore[misc]


ROLES: dict[str, Callable[[RosClient, Instance], None]] = {"operator": operator, "planner": planner}


@contextlib.contextmanager
def working(run: Run) -> Iterator[dict[str, int]]:
    """Run all clients of a running system during the block, and a browser at its page if there is one.

    Yields:
        Their process ids, by role.

    Raises:
        ValorError: a client received no messages in time, or ended during the block; names it.
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
            run.progress.waiting(f"starting the {role}")
            assert process.stdout is not None
            if process.stdout.readline().strip() != READY:  # it ends after its timeout
                raise ValorError(f"{role}: ended before it received messages of the robot")
        if shutil.which(BROWSER):
            began[BROWSER] = _browse(run)
        yield {role: process.pid for role, process in began.items()}
        if ended := [role for role, process in began.items() if process.poll() is not None]:
            raise ValorError(f"{', '.join(ended)}, ended during the measurement")
    finally:
        for process in began.values():
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGTERM)  # a browser is many
        for process in began.values():
            try:
                process.wait(ENDING)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
            if process.stdout is not None:
                process.stdout.close()


def _browse(run: Run) -> subprocess.Popen[str]:
    """Start a browser at the operator's page, at a low priority, and wait until the view is connected."""
    settings = run.instance.settings()
    command = ["nice", "-n", str(NICE), BROWSER, *_ARGUMENTS, f"--user-data-dir={run.out / BROWSER}"]
    process = subprocess.Popen([*command, url(page_port(settings))], stdout=subprocess.DEVNULL,
                               stderr=subprocess.DEVNULL, text=True, start_new_session=True)  # fmt: skip
    run.progress.waiting("opening the page in a browser")
    deadline = time.monotonic() + OPENING
    while not any(
        one.raddr and one.raddr.port == scene_port(settings) and one.status == psutil.CONN_ESTABLISHED
        for one in psutil.net_connections("tcp")
    ):
        run.interruption.check()
        if time.monotonic() > deadline or process.poll() is not None:
            os.killpg(process.pid, signal.SIGKILL)
            raise ValorError(f"{BROWSER}: does not show the page {url(page_port(settings))}")
        time.sleep(0.5)
    return process


def _note(received: set[str], topic: str, _message: Any) -> None:
    received.add(topic)


def _say_ready() -> None:
    print(READY, flush=True)


def main(role: str) -> int:
    """Work until terminated; returns the exit status."""
    from valor.valorctl.drive.ros_client import RosClient

    instance, parent = Instance.from_environment(), os.getppid()
    with Interruption() as interruption:

        def check() -> None:
            interruption.check()
            if os.getppid() != parent:
                raise ValorError("the parent process has ended")

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
