"""Walking in closed loop, on a plant that is not the controller's model, in one process."""

from typing import Self

import mujoco
import numpy as np
import pytest

from harness.closed_loop import ClosedLoop, load_robot
from valor.control.steps import Step
from valor.robot.description import RobotDescription
from valor.robot.footsteps import LEFT, RIGHT
from valor.simulation import worlds
from valor.simulation.worlds.world import ground
from valor.whole_body.walking.footsteps import StepQueue, level_pose
from valor.whole_body.walking.velocity_steps import VelocitySteps


def walk(loop: ClosedLoop, velocity: tuple[float, float, float], seconds: float) -> tuple[np.ndarray, float]:
    """Walk, stop and come to rest; the DCM's errors (k, 3) [m], and the smallest knee angle [rad]."""
    source = VelocitySteps(loop.robot.tables.walking)
    loop.request.steps = source
    knees = [loop.robot.index[name] for name in ("l_knee_pitch", "r_knee_pitch")]
    errors, knee = [], np.inf
    until = loop.time + seconds
    while loop.fall is None and (loop.time < until or not loop.controller.at_rest):
        if loop.time < until:
            source.command(np.array(velocity), loop.time)
        source.advance(loop.time)
        loop.step()
        errors.append(loop.state.dcm_in_odom - loop.command.dcm_reference_in_odom)
        knee = min(knee, float(loop.plant.joint_position[knees].min()))
    return np.array(errors), knee


@pytest.mark.parametrize(
    ("velocity", "seed"), [((0.4, 0.0, 0.0), 0), ((0.3, 0.0, 0.2), 1), ((0.0, 0.08, 0.0), 2)], ids=str
)
def test_walks_and_comes_to_rest(robot: RobotDescription, velocity: tuple[float, float, float], seed: int) -> None:
    loop = ClosedLoop(robot, "hardware", seed)
    loop.settle(0.3)
    loop.run(0.5)  # not even at nominal yet
    before, believed = loop.plant.data.qpos[:3].copy(), loop.state.pelvis_position_in_odom
    errors, knee = walk(loop, velocity, 4.0)
    assert loop.fall is None and loop.command.qp_failures == 0
    assert (np.sqrt((errors**2).mean(axis=0)) < 0.025).all()
    assert knee > 0.5
    way = loop.plant.data.qpos[:3] - before
    assert np.linalg.norm(way[:2]) > 0.15
    np.testing.assert_allclose(loop.state.pelvis_position_in_odom - believed, way, atol=0.06)
    loop.run(2.0)
    assert np.abs(loop.plant.data.qvel[:3]).max() < 0.02
    soles = loop.state.sole_positions_in_odom
    assert np.linalg.norm(soles[0] - soles[1]) == pytest.approx(robot.tables.walking.step_width, abs=0.03)


@pytest.mark.parametrize("frequency", ["constant", "varying"])
def test_climbs_stairs_step_over_step(frequency: str) -> None:
    """Three steps of 15 cm, one foot on each."""
    loop = ClosedLoop(load_robot(whole_body={"natural_frequency": frequency}), "hardware", 0, world="stairs_15cm")
    loop.settle(0.3)
    loop.run(1.5)
    footholds = [(0.16, 0.0), (0.32, 0.0), (0.625, 0.15), (0.925, 0.3), (1.225, 0.45), (1.225, 0.45)]
    queue = StepQueue()
    queue.begin(
        [
            Step(i, foot, level_pose(x, 0.1 if foot == LEFT else -0.1, z, 0.0), 0.08, 1.0 if z else 0.6, 0.4)
            for i, ((x, z), foot) in enumerate(zip(footholds, (LEFT, RIGHT) * 3, strict=True))
        ]
    )
    loop.request.steps = queue
    knees = [loop.robot.index[name] for name in ("l_knee_pitch", "r_knee_pitch")]
    before, errors, knee = loop.plant.data.qpos[2], [], np.inf
    while queue.running and loop.fall is None:
        loop.step()
        errors.append(loop.state.dcm_in_odom - loop.command.dcm_reference_in_odom)
        knee = min(knee, float(loop.plant.joint_position[knees].min()))
    assert loop.fall is None
    assert queue.last_performed == 5
    assert loop.command.qp_failures == 0
    assert (np.sqrt((np.array(errors) ** 2).mean(axis=0)) < (0.015, 0.015, 0.035)).all()
    assert knee > 0.25
    assert loop.plant.data.qpos[2] - before == pytest.approx(0.45, abs=0.04)


class Drops:
    """Level ground, and twice a step down across the way, at 1.1 m and at 1.9 m."""

    def __init__(self, depth: float) -> None:
        """Args: depth: of each [m]."""
        self._depth = depth

    def sized(self, size: float) -> Self:
        return self

    def add_to(self, spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
        for i, (begin, end) in enumerate(((-2.0, 1.1), (1.1, 1.9), (1.9, 8.0))):
            ground(spec, type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.5 * (end - begin), 3.0, 0.5],
                   pos=[0.5 * (begin + end), 0.0, -0.5 - i * self._depth])  # fmt: skip


def test_a_foot_that_finds_no_ground_yet_is_no_fall(robot: RobotDescription, monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps down of 5 cm that nobody told of, at 0.45 m/s: twice as deep as a foot is led."""
    monkeypatch.setitem(worlds.WORLDS, "drops", Drops(0.05))
    loop = ClosedLoop(robot, "hardware", 1, world="drops")
    loop.settle(0.3)
    loop.run(0.5)
    before = loop.plant.data.qpos[:3].copy()
    errors, knee = walk(loop, (0.45, 0.0, 0.0), 7.0)
    assert loop.fall is None
    forward, _, up = (loop.plant.data.qpos[:3] - before).tolist()
    assert forward > 2.1  # beyond both
    assert up == pytest.approx(-0.1, abs=0.03)
    assert (np.sqrt((errors**2).mean(axis=0)) < (0.02, 0.015, 0.02)).all()
    assert knee > 0.1  # of a leg that finds the ground late


def test_walks_at_a_thousand_periods_a_second_as_at_five_hundred() -> None:
    loop = ClosedLoop(load_robot(control_rate=1000.0), "hardware", 3)
    loop.settle(0.3)
    loop.run(0.5)
    before = loop.plant.data.qpos[:3].copy()
    errors, _ = walk(loop, (0.3, 0.0, 0.0), 2.5)
    assert len(errors) > 1000 * 2.5
    assert loop.fall is None and loop.command.qp_failures == 0
    assert (np.sqrt((errors**2).mean(axis=0)) < 0.02).all()
    assert loop.plant.data.qpos[0] - before[0] > 0.4


def test_standing_goes_over_into_stepping_without_a_jump(robot: RobotDescription) -> None:
    loop = ClosedLoop(robot)
    loop.run(2.5)
    effort, dcm = loop.command.effort, loop.command.dcm_reference_in_odom
    source = VelocitySteps(robot.tables.walking)
    loop.request.steps = source
    source.command(np.array([0.3, 0.0, 0.0]), loop.time)
    loop.run(0.01)
    assert not loop.controller.at_rest
    np.testing.assert_allclose(loop.command.dcm_reference_in_odom, dcm, atol=1e-3)
    assert np.abs(loop.command.effort - effort).max() < 6.0  # [N·m]
