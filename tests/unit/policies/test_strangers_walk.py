"""Policies and robots of strangers: each takes over from the Whole-Body Controller, is pushed, walks and gives back."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest

from harness.strangers import PLAYGROUND, ROBOTS, policy_of
from valor.common.behaviors import Behavior
from valor.policies.factories import policy_controller
from valor.robot.description import RobotDescription
from valor.robot_setup.new import new_robot
from valor.self_test.closed_loop import ClosedLoop
from valor.self_test.controller_test import ControllerTest

pytestmark = pytest.mark.timeout(900)
TESTS = ("push left", Behavior.WALK, "give back")


@pytest.fixture(scope="module", params=ROBOTS)
def robot(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> RobotDescription:
    """Made of the model's file, with nothing edited."""
    folder = tmp_path_factory.mktemp("robots") / request.param
    new_robot(ROBOTS[request.param].model(), folder, request.param)
    return RobotDescription.load(folder)


def test_without_a_policy_it_steps_when_it_is_pushed(robot: RobotDescription) -> None:
    loop = ClosedLoop(robot, "hardware", seed=0)
    loop.settle(0.3)
    loop.run(1.0)
    loop.plant.push(np.array((0.65 * robot.tables.size.mass, 0.0, 0.0)), 0.1)
    stepped, until = False, loop.time + 6.0
    while loop.fall is None and loop.time < until and not (stepped and loop.controller.at_rest):
        loop.step()
        stepped |= loop.controller.recovering
    assert loop.fall is None and stepped and loop.controller.at_rest


@pytest.mark.parametrize("kind", ["ppo", "fastsac"])
def test_a_policy_takes_over_is_pushed_walks_and_gives_back(robot: RobotDescription, kind: str, tmp_path: Path) -> None:
    file = policy_of(robot.tables.name, kind, tmp_path)
    tests = dict(ControllerTest(robot, "hardware", file.stem, partial(policy_controller, file)).tests())
    for name in TESTS:
        result = tests[name]()
        assert result.passed, (name, result.reason)


@pytest.mark.parametrize("robot", ["g1"], indirect=True)
@pytest.mark.parametrize("name", [Behavior.WALK, "give back"])
def test_one_that_steps_in_place_walks_at_the_commanded_velocity_and_gives_back(
    robot: RobotDescription, name: str, tmp_path: Path
) -> None:
    file = policy_of("g1", PLAYGROUND, tmp_path)
    result = dict(ControllerTest(robot, "hardware", file.stem, partial(policy_controller, file)).tests())[name]()
    assert result.passed, result.reason


def test_one_with_a_wrong_scale_is_rejected_or_replaced_before_the_robot_falls(
    robot: RobotDescription, tmp_path: Path
) -> None:
    file = policy_of(robot.tables.name, "ppo", tmp_path, action_scale=2.5)
    test = ControllerTest(robot, "hardware", file.stem, partial(policy_controller, file))
    result = dict(test.tests())["take over"]()
    assert not result.passed and "fell" not in result.reason, result.reason
