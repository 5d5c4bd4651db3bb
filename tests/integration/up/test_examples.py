"""Every program of ``examples/``, run as its reader runs it."""

import os
import pty
import re
import struct
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from nav_msgs.msg import Odometry

from harness.places import REPOSITORY
from harness.system import RosClient, System
from harness.waiting import wait_until

EXAMPLES = REPOSITORY / "examples"
L1, SELECT, START, LEFT_Y = 4, 6, 7, 1  # of a gamepad
BUTTON, AXIS = 1, 2
EVENT = struct.Struct("IhBB")  # of Linux' joystick API


def example(system: System, name: str, *arguments: str, expect: int = 0) -> str:
    """Run one to its end; what it prints."""
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / name), *arguments],
        env=system.join(), capture_output=True, text=True, timeout=180.0, check=False,
    )  # fmt: skip
    assert done.returncode == expect, f"{name}: exit {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done.stdout + done.stderr


class Way:
    """How far the robot has come along odom's x."""

    def __init__(self, ros: RosClient) -> None:
        self.x: list[float] = []
        ros._call(ros.node.create_subscription, Odometry, "/odom", self._hear, 10)
        wait_until(lambda: len(self.x) > 50 and self.rests, 20.0, "the robot to rest")
        self.begin = self.x[-1]

    def _hear(self, odometry: Odometry) -> None:
        self.x.append(odometry.pose.pose.position.x)

    @property
    def gone(self) -> float:
        """Since it was made [m]."""
        return self.x[-1] - self.begin

    @property
    def rests(self) -> bool:
        """True if it has gone nowhere for some time."""
        return float(np.ptp(self.x[-50:])) < 0.002


def test_all_are_short_and_documented() -> None:
    reported = (REPOSITORY / "docs" / "tools.md").read_text()
    for file in sorted(EXAMPLES.glob("*.py")):
        assert f"`{file.name}`" in reported, file.name
        if file.name not in ("stand_and_reach.py", "streams.py", "mjlab_task.py"):
            assert len(file.read_text().splitlines()) <= 60, file.name
            assert not re.search(r"^(import|from) (valor|bifrost)\b", file.read_text(), re.MULTILINE), file.name


def test_joint_states(system: System, ros: RosClient) -> None:
    printed = example(system, "joint_states.py", "2")
    assert len(re.findall(r"^robot time", printed, re.MULTILINE)) == 2
    shown = re.findall(r"^  (\w+) +-?[\d.]+ rad ", printed, re.MULTILINE)
    assert shown == 2 * list(ros.joint_positions())


def test_arm_goal_turns_one_joint_of_the_arm(system: System, ros: RosClient) -> None:
    before = ros.joint_positions()
    printed = example(system, "arm_goal.py", "right", "elbow_pitch", "0.3")
    (joint,) = re.findall(r"^(\w+) is at", printed, re.MULTILINE)
    wait_until(
        lambda: abs(ros.joint_positions()[joint] - before[joint] - 0.3) < 0.03, 20.0, f"{joint} has turned by 0.3 rad"
    )
    others = {name: angle for name, angle in ros.joint_positions().items() if name.startswith(joint[:8])}
    assert max(abs(angle - before[name]) for name, angle in others.items() if name != joint) < 0.05


def test_modes_are_changed_and_what_is_none_is_refused(system: System, ros: RosClient) -> None:
    assert "control mode stand\n" in example(system, "modes.py", "stand")
    assert "mode dance not reached" in example(system, "modes.py", "dance", expect=1)


def test_walk_and_stop(system: System, ros: RosClient) -> None:
    way = Way(ros)
    printed = example(system, "walk_and_stop.py", "-0.1", "4")  # away from the stairs
    (reported,) = re.findall(r"walked (-?[\d.]+) m", printed)
    assert way.gone < -0.1 and float(reported) == pytest.approx(way.gone, abs=0.1)
    assert ros.reports[-1].current_control_mode == "stand"


def test_footsteps(system: System, ros: RosClient) -> None:
    way = Way(ros)
    assert "3 steps done" in example(system, "footsteps.py", "2", "0.1")
    example(system, "modes.py", "stand")
    wait_until(lambda: way.rests, 20.0, "the robot to rest: a plan is done when its last foot is down")
    assert way.gone == pytest.approx(0.2, abs=0.02)


def test_keyboard(system: System, ros: RosClient) -> None:
    master, terminal = pty.openpty()
    program = subprocess.Popen(
        [sys.executable, str(EXAMPLES / "keyboard.py")], env=system.join(), stdin=terminal, stdout=subprocess.DEVNULL
    )
    try:
        wait_until(lambda: ros.reports and ros.reports[-1].current_control_mode == "walk", 60.0, "it walks")
        way = Way(ros)
        with repeating(lambda: os.write(master, b"s")):
            wait_until(lambda: way.gone < -0.1, 60.0, "it goes back while s is held")
        os.write(master, b"x")
        assert program.wait(60.0) == 0
    finally:
        program.kill()
        program.wait()
        os.close(master)
        os.close(terminal)
    assert ros.reports[-1].current_control_mode == "stand"


def test_gamepad(system: System, ros: RosClient, tmp_path: Path) -> None:
    device = tmp_path / "js0"
    os.mkfifo(device)
    program = subprocess.Popen([sys.executable, str(EXAMPLES / "gamepad.py"), str(device)], env=system.join())
    pad = os.open(device, os.O_WRONLY)

    def event(kind: int, number: int, value: int) -> None:
        os.write(pad, EVENT.pack(0, value, kind, number))

    try:
        event(BUTTON, START, 1)
        wait_until(lambda: ros.reports and ros.reports[-1].current_control_mode == "walk", 60.0, "Start: it walks")
        way = Way(ros)
        event(AXIS, LEFT_Y, 16000)
        event(BUTTON, L1, 1)
        wait_until(lambda: way.gone < -0.1, 60.0, "back with the stick, while L1 is held")
        event(BUTTON, L1, 0)
        event(BUTTON, SELECT, 1)
        wait_until(lambda: ros.reports[-1].current_control_mode == "stand", 60.0, "Select: it stands")
    finally:
        os.close(pad)  # the gamepad is pulled out
        try:
            assert program.wait(60.0) == 0
        finally:
            program.kill()
            program.wait()


class repeating:  # noqa: N801  # used as a verb
    """A key that is held."""

    def __init__(self, press: Callable[[], object]) -> None:
        self._press, self._let_go = press, threading.Event()
        self._thread = threading.Thread(target=self._hold, daemon=True)

    def _hold(self) -> None:
        while not self._let_go.wait(0.1):
            self._press()

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *exception: object) -> None:
        self._let_go.set()
        self._thread.join()
