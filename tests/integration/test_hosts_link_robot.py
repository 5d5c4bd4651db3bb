"""A robot on two computers and its operator behind the link: it reaches, steps, is stopped; other verbs say where."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from harness.computers import ComputersError
from harness.hosts import Hosts, deployment_text, hosts
from harness.waiting import wait_until

pytestmark = pytest.mark.timeout(1200)
HEALED = 120.0  # [s]


@pytest.fixture(scope="module")
def robot() -> Iterator[Hosts]:
    text = deployment_text("drc-link")
    with tempfile.TemporaryDirectory(prefix="vk-", ignore_cleanup_errors=True) as folder:
        try:
            with hosts(Path(folder), text, "trio", "motion", "perception", "operator") as made:
                for side in ("motion", "operator"):
                    made.valorctl(side, "up", "--deployment", str(made.file))
                yield made
        except ComputersError as error:
            pytest.skip(str(error))


def true(robot: Hosts) -> dict[str, Any]:
    """What the Motion Manager says, on its own computer."""
    said = json.loads(robot.valorctl("motion", "topic", "echo", "motion_manager/motion_state", "--once", "--json"))
    state: dict[str, Any] = said.get("message", said)
    return state


def shown(robot: Hosts) -> dict[str, Any]:
    """The control mode as the operator is told it."""
    found: dict[str, Any] = json.loads(robot.valorctl("operator", "mode", "--json"))
    return found


def test_it_reaches_and_the_operator_sees_what_is(robot: Hosts) -> None:
    wait_until(lambda: robot.status("operator")["ready"], HEALED, "every process is ready", 0.5)
    assert robot.status("operator")["behavior"] == "stand"
    robot.valorctl("operator", "mode", "stand_manipulate")
    assert true(robot)["behavior"] == "stand_manipulate"
    wait_until(lambda: shown(robot)["control_mode"] == "stand_manipulate", 60.0, "it is shown")
    assert 0.0 < shown(robot)["age_s"] < HEALED
    assert "right arm in forward" in robot.valorctl("operator", "arm", "right", "forward")


def test_it_walks_steps_that_the_operator_approved(robot: Hosts) -> None:
    robot.valorctl("operator", "mode", "step")
    before = true(robot)["pelvis_position_in_odom"]
    robot.valorctl("operator", "step", "--to", "0.4", "0", "0", "--relative")
    after = true(robot)["pelvis_position_in_odom"]
    assert abs(math.dist(before[:2], after[:2]) - 0.4) < 0.1


def test_what_the_link_does_not_carry_is_refused_with_where_it_can_be_done(robot: Hosts) -> None:
    for verb in (("walk", "--vx", "0.1"), ("bag", "snap"), ("push", "10", "0", "0")):
        said = robot.valorctl("operator", *verb, expect=1)
        assert "run it on motion or perception" in said, said


def test_its_operator_stops_it_and_nothing_is_left_of_it(robot: Hosts) -> None:
    said = robot.valorctl("operator", "stop")
    assert "stopped after" in said and "through the link" in said
    assert true(robot)["behavior"] == "soft_stop"
    robot.valorctl("operator", "down")
    wait_until(lambda: not any(map(robot.left, robot.network.addresses)), 30.0, "nothing is left on any")
