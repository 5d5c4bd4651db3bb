"""Every robot of ``robots/`` stands and walks on its own tables, in a plant that is not what is believed of it."""

import math
from typing import Literal

import numpy as np
import pytest

from harness.closed_loop import ClosedLoop, load_robot
from harness.places import ROBOTS
from valor.robot.step_plan import plan_to
from valor.self_test.plan_walk import walk_plan
from valor.whole_body.walking.velocity_steps import VelocitySteps

SPEED = 0.3  # [m/s]
DURATION = 3.0  # [s]
REACHING = 1.5  # [s]
IMPULSE = 15.0  # of a push [N·s]
OTHERS = sorted(file.parent.name for file in ROBOTS.glob("*/robot.yaml") if file.parent.name != "escher")


@pytest.mark.parametrize("name", OTHERS)  # ESCHER does all this in many a test
def test_it_stands_reaches_walks_and_stops(name: str) -> None:
    loop = ClosedLoop(load_robot(name), "hardware", seed=1)
    loop.settle(0.3)
    loop.run(1.5)
    reach(loop, "left", "forward")
    arm = loop.robot.group_indices("left_arm")
    error = np.abs(loop.plant.joint_position[arm] - loop.reference.position[arm])
    assert error.max() < 0.05, loop.robot.joints[arm[np.argmax(error)]]  # what trajectory controllers allow a goal
    assert np.abs(loop.state.dcm_in_odom - loop.command.dcm_reference_in_odom).max() < 0.02
    source = loop.request.steps = VelocitySteps(loop.robot.tables.walking)
    start, began, errors = loop.plant.data.qpos[:3].copy(), loop.time, []
    while loop.fall is None and (loop.time < began + DURATION or not loop.controller.at_rest):
        if loop.time < began + DURATION:
            source.command(np.array((SPEED, 0.0, 0.0)), loop.time)
        source.advance(loop.time)
        loop.step()
        errors.append(loop.state.dcm_in_odom - loop.command.dcm_reference_in_odom)
        assert loop.time < began + 3 * DURATION
    assert loop.fall is None
    way = loop.plant.data.qpos[:3] - start
    assert 0.7 * SPEED * DURATION < way[0] < 1.3 * SPEED * DURATION and abs(way[1]) < 0.1
    assert np.sqrt(np.mean(np.square(errors), axis=0)).max() < 0.02  # measured, with the arms down: 3, 6, 6 mm


def reach(loop: ClosedLoop, side: Literal["left", "right"], preset: str) -> None:
    """Lead an arm to a preset, smoothly, and let it settle."""
    arm, reference = loop.robot.group_indices(f"{side}_arm"), loop.reference
    start = reference.position[arm].copy()
    goal = np.array(list(loop.robot.tables.arm_presets[preset][side].values()))
    began = loop.time
    while (share := (loop.time - began) / REACHING) < 1.0:
        reference.position[arm] = start + (10 - 15 * share + 6 * share**2) * share**3 * (goal - start)
        reference.velocity[arm] = 30 * (1 - share) ** 2 * share**2 * (goal - start) / REACHING
        loop.step()
    reference.position[arm], reference.velocity[arm] = goal, 0.0
    loop.run(0.5)


@pytest.mark.parametrize("name", ["escher", *OTHERS])
def test_it_takes_a_footstep_plan(name: str) -> None:
    robot = load_robot(name)
    assert robot.tables.footsteps is not None
    steps = plan_to((0.25, 0.1, 0.3), robot.tables.footsteps, robot.tables.walking)
    walked = walk_plan(robot, steps, seed=2)
    assert walked.done, walked
    assert walked.true[0] < 0.03 and walked.true[1] < math.radians(3.0), walked


@pytest.mark.parametrize("name", OTHERS)
def test_it_stands_pushes(name: str) -> None:
    loop = ClosedLoop(load_robot(name), "hardware", seed=2)
    loop.settle(0.3)
    loop.run(1.5)
    for direction in ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0)):
        loop.plant.push(IMPULSE * np.array(direction), 0.1)
        loop.run(2.5)
    assert loop.fall is None and np.hypot(*(loop.state.dcm_in_odom - loop.command.dcm_reference_in_odom)[:2]) < 0.02
