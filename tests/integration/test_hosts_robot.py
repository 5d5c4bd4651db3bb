"""A robot on three computers with clocks 5 s apart: it stands, reaches and walks while cables are pulled."""

import json
import math
import re
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from harness.computers import ComputersError
from harness.hosts import Hosts, deployment_text, hosts
from harness.system import VALORCTL
from harness.waiting import wait_until

HEALED = 60.0  # [s]
STILL = 0.04  # largest motion of balancing [m]
LONG = 8.0  # cut after which `walk` fails [s]


@pytest.fixture(scope="module")
def robot() -> Iterator[Hosts]:
    text = deployment_text("drc")
    with tempfile.TemporaryDirectory(prefix="vh-", ignore_cleanup_errors=True) as folder:
        try:
            names = ("motion", "perception", "operator")
            with hosts(Path(folder), text, "trio", *names, perception=3.0, operator=-2.0) as made:
                made.valorctl("operator", "up", "--deployment", str(made.file))
                yield made
        except ComputersError as error:
            pytest.skip(str(error))


def motion(robot: Hosts) -> dict[str, Any]:
    said = robot.valorctl("motion", "topic", "echo", "motion_manager/motion_state", "--once", "--json")
    found: dict[str, Any] = json.loads(said)
    state: dict[str, Any] = found.get("message", found)
    return state


def position(robot: Hosts) -> list[float]:
    """Horizontal position of the pelvis [m]."""
    return list(motion(robot)["pelvis_position_in_odom"][:2])


def resting(robot: Hosts) -> list[float]:
    """Position at which it comes to rest [m]; also in mode walk, without a velocity."""
    positions = [position(robot)]

    def rests() -> bool:
        positions.append(position(robot))  # a moment later: the request takes a command
        return math.dist(*positions[-2:]) < STILL / 4

    wait_until(rests, 60.0, "it comes to rest")
    return positions[-1]


def behavior(robot: Hosts) -> str:
    return str(motion(robot)["behavior"])


def healed(robot: Hosts) -> None:
    """Wait until the operator's host reports every process ready, without help."""
    wait_until(lambda: robot.status("operator")["ready"], HEALED, "every process is ready again", 0.5)


def walking(robot: Hosts, seconds: float) -> subprocess.Popen[str]:
    """Start to walk by the operator's command; returns once the robot walks."""
    command = robot.command("operator", str(VALORCTL), "walk", "--vx", "0.3", "--for", f"{seconds:g}")
    walk = subprocess.Popen(
        command, env=robot.environment("operator"), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    wait_until(lambda: behavior(robot) == "walk", 60.0, "it walks")
    return walk


def test_it_reaches_and_every_host_measures_delays_by_its_clock(robot: Hosts) -> None:
    robot.valorctl("operator", "mode", "stand_manipulate")
    assert "right arm in forward" in robot.valorctl("perception", "arm", "right", "forward")
    robot.valorctl("operator", "mode", "stand")
    for name in ("perception", "operator"):
        said = robot.valorctl(name, "topic", "hz", "comms_manager/proprioceptor", "--for", "1")
        median = re.search(r"delay median (-?\d+)", said)
        assert median and -0.5e6 < int(median[1]) < 0.5e6, said  # [µs], of clocks that are 3 s and 2 s away


@pytest.mark.parametrize(("host", "seconds"), [("perception", 0.2), ("motion", 2.0)])
def test_it_keeps_walking_through_a_short_cut(robot: Hosts, host: str, seconds: float) -> None:
    walk = walking(robot, 5.0)
    robot.network.pull(host)
    time.sleep(seconds)  # the cut itself
    robot.network.plug(host)
    said, _ = walk.communicate(timeout=200.0)
    assert behavior(robot) in ("walk", "stand"), said
    healed(robot)
    robot.valorctl("operator", "mode", "stand")


def test_without_its_operator_it_stops_and_executes_no_late_command(robot: Hosts) -> None:
    walk = walking(robot, 60.0)
    robot.network.pull("operator")
    said, _ = walk.communicate(timeout=200.0)
    assert walk.returncode == 1 and "no motion_manager/motion_state for" in said, "`walk` reports the cut"
    before = resting(robot)
    robot.network.plug("operator")
    healed(robot)
    assert math.dist(resting(robot), before) < STILL, "it executed a late command"
    robot.valorctl("operator", "walk", "--vx", "0.3", "--for", "3")
    assert math.dist(position(robot), before) > 5 * STILL, "it executes no command any more"


def test_it_stands_without_its_perception_and_all_recovers(robot: Hosts) -> None:
    robot.valorctl("operator", "mode", "stand")
    before = resting(robot)
    robot.network.pull("perception")
    time.sleep(LONG)  # the cut itself
    states = robot.states("operator")
    assert (states["motion_manager"], states["valor_ros_controller"]) == ("ready", "failed")
    assert behavior(robot) == "stand"
    robot.network.plug("perception")
    healed(robot)
    assert behavior(robot) == "stand" and math.dist(resting(robot), before) < STILL
    robot.valorctl("operator", "mode", "stand_manipulate")
