"""A robot on three computers whose clocks are 5 s apart: it stands, reaches, walks; and cables are pulled meanwhile."""

from __future__ import annotations

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
STILL = 0.04  # what balancing takes at most [m]
LONG = 8.0  # cut, for which `walk` gives up, and TCP its connections [s]


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
    """What the Motion Manager says of itself."""
    said = robot.valorctl("motion", "topic", "echo", "motion_manager/motion_state", "--once", "--json")
    found: dict[str, Any] = json.loads(said)
    state: dict[str, Any] = found.get("message", found)
    return state


def place(robot: Hosts) -> list[float]:
    """Where the pelvis is, over ground [m]."""
    return list(motion(robot)["pelvis_position_in_odom"][:2])


def apart(one: list[float], other: list[float]) -> float:
    """Of two places [m]."""
    return math.dist(one, other)


def resting(robot: Hosts) -> list[float]:
    """Where it rests [m], once it does: in mode walk, too, without a velocity."""
    places = [place(robot)]

    def rests() -> bool:
        places.append(place(robot))  # a moment later: it takes a command to ask
        return apart(*places[-2:]) < STILL / 4

    wait_until(rests, 60.0, "it comes to rest")
    return places[-1]


def behavior(robot: Hosts) -> str:
    """The Motion Manager's."""
    return str(motion(robot)["behavior"])


def healed(robot: Hosts) -> None:
    """Wait until every process is ready, as the operator sees it; nobody has done anything for that."""
    wait_until(lambda: robot.status("operator")["ready"], HEALED, "every process is ready again", 0.5)


def walking(robot: Hosts, seconds: float) -> subprocess.Popen[str]:
    """The operator has the robot walk; returns once it does."""
    command = robot.command("operator", str(VALORCTL), "walk", "--vx", "0.3", "--for", f"{seconds:g}")
    walk = subprocess.Popen(
        command, env=robot.environment("operator"), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    wait_until(lambda: behavior(robot) == "walk", 60.0, "it walks")
    return walk


def test_it_reaches_and_every_host_sees_it_by_its_own_clock(robot: Hosts) -> None:
    robot.valorctl("operator", "mode", "stand_manipulate")
    assert "right arm in forward" in robot.valorctl("perception", "arm", "right", "forward")
    robot.valorctl("operator", "mode", "stand")
    for name in ("perception", "operator"):
        said = robot.valorctl(name, "topic", "delay", "comms_manager/proprioceptor", "--for", "1")
        median = re.search(r"median (-?\d+)", said)
        assert median and -0.5e6 < int(median[1]) < 0.5e6, said  # [µs], of clocks that are 3 s and 2 s away


@pytest.mark.parametrize(("host", "seconds"), [("perception", 0.2), ("motion", 2.0)])
def test_it_walks_on_without_the_others_for_a_moment(robot: Hosts, host: str, seconds: float) -> None:
    walk = walking(robot, 5.0)
    robot.network.pull(host)
    time.sleep(seconds)  # the cut itself
    robot.network.plug(host)
    said, _ = walk.communicate(timeout=200.0)
    assert behavior(robot) in ("walk", "stand"), said
    healed(robot)
    robot.valorctl("operator", "mode", "stand")


def test_without_its_operator_it_stops_and_obeys_nothing_that_comes_late(robot: Hosts) -> None:
    walk = walking(robot, 60.0)
    robot.network.pull("operator")
    said, _ = walk.communicate(timeout=200.0)
    assert walk.returncode == 1 and "silent" in said, "the operator is told"
    before = resting(robot)
    robot.network.plug("operator")
    healed(robot)
    assert apart(resting(robot), before) < STILL, "it has gone on"
    robot.valorctl("operator", "walk", "--vx", "0.3", "--for", "3")
    assert apart(place(robot), before) > 5 * STILL, "it obeys nobody any more"


def test_standing_without_its_perception_it_stands_and_all_comes_back(robot: Hosts) -> None:
    robot.valorctl("operator", "mode", "stand")
    before = resting(robot)
    robot.network.pull("perception")
    time.sleep(LONG)  # the cut itself
    states = robot.states("operator")
    assert (states["motion_manager"], states["valor_ros_controller"]) == ("ready", "failed")
    assert behavior(robot) == "stand"
    robot.network.plug("perception")
    healed(robot)
    assert behavior(robot) == "stand"
    assert apart(resting(robot), before) < STILL
    robot.valorctl("operator", "mode", "stand_manipulate")
