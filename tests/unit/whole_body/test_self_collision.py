"""Parts of the robot keep apart: the rows against differences of distances, and what they do in closed loop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import pytest

from harness.closed_loop import ClosedLoop, load_robot
from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.robot.description import RobotDescription
from valor.robot.footsteps import LEFT
from valor.robot.model import controller_model
from valor.whole_body.constraints.self_collision import SelfCollision
from valor.whole_body.model.dynamics import Dynamics
from valor.whole_body.tasks.table import motions
from valor.whole_body.walking.footsteps import Step, level_pose
from valor.whole_body.walking.swing import SolePose

NOBODY: dict[str, Any] = {"self_collision": {"pairs": []}}
ARM = {"l_shoulder_roll": -0.3, "l_shoulder_yaw": -1.5, "l_elbow_pitch": 0.3, "l_shoulder_pitch": 0.2}  # into the chest
UPRIGHT = (1.0, 0.0, 0.0, 0.0)


def evaluate(dynamics: Dynamics, position: FloatArray, velocity: FloatArray) -> Dynamics:
    """At a posture, upright and without turning."""
    dynamics.update(rotation.quaternion(UPRIGHT), np.zeros(3), position, velocity)
    return dynamics


@pytest.mark.parametrize("pair", [("l_thigh", "r_thigh"), ("l_thigh", "r_shin"), ("l_shin", "r_shin")])
def test_a_row_is_how_the_distance_changes(pair: tuple[str, str]) -> None:
    """Between capsules: ḋ is row·v, and from it comes the barrier."""
    robot = load_robot(self_collision={"pairs": [pair], "near": 0.45, "distance": 0.0})
    model = controller_model(robot)
    dynamics, collision = Dynamics(model, motions(model)), SelfCollision(model)
    one, other = model.shape(pair[0]), model.shape(pair[1])
    rng, step, segment = np.random.default_rng(4), 1e-4, np.zeros(6)
    posture = robot.nominal_posture[dynamics.joints.places]
    for k in range(8):
        position = posture + rng.uniform(-0.15, 0.15, posture.size)
        velocity = rng.uniform(-0.5, 0.5, posture.size)
        distances = [
            evaluate(dynamics, position + i * step * velocity, velocity).nearest(one, other, 1.0, segment)
            for i in (-1, 0, 1)
        ]
        limit = collision.update(evaluate(dynamics, position, velocity), velocity, k)
        assert limit is not None
        assert limit.rows[0, :6] == pytest.approx(0.0, abs=1e-6)  # the pelvis carries both
        rate = (distances[2] - distances[0]) / (2.0 * step)
        assert float(limit.rows[0, 6:] @ velocity) == pytest.approx(rate, abs=2e-4)
        table = robot.tables.self_collision
        allowed = min(0.3, -table.approach * distances[1])
        assert collision.lower[0] == pytest.approx(table.response * (allowed - rate), abs=0.05)


def test_pairs_that_are_far_are_looked_at_seldom(robot: RobotDescription, monkeypatch: pytest.MonkeyPatch) -> None:
    loop = ClosedLoop(robot)
    looks = 0
    nearest = Dynamics.nearest

    def count(dynamics: Dynamics, one: int, other: int, reach: float, segment: FloatArray) -> float:
        nonlocal looks
        looks += 1
        return nearest(dynamics, one, other, reach, segment)

    monkeypatch.setattr(Dynamics, "nearest", count)
    loop.run(0.4)
    pairs, periods = len(robot.tables.self_collision.pairs), len(loop.tick_times)
    assert pairs < looks < 0.15 * pairs * periods
    assert loop.controller.near_pairs == 0


def reach_into_the_chest(loop: ClosedLoop) -> float:
    """Lead the left arm there; the least distance of forearm and hand from the chest in the plant [m]."""
    loop.settle(0.3)
    loop.run(0.3)
    model, segment, least = loop.plant.model, np.zeros(6), np.inf
    shapes, chest = (model.shape("l_hand"), model.shape("l_forearm")), model.shape("chest")
    start = loop.reference.position.copy()
    goal = start.copy()
    for joint, angle in ARM.items():
        goal[loop.robot.index[joint]] = angle
    began = loop.time

    def lead(loop: ClosedLoop) -> None:
        nonlocal least
        share = min(1.0, loop.time - began)
        loop.reference.position[:] = start + share * (goal - start)
        loop.reference.velocity[:] = (goal - start) * (share < 1.0)
        distances = [mujoco.mj_geomDistance(model.mj, loop.plant.data, s, chest, 1.0, segment) for s in shapes]
        least = min(least, *distances)

    loop.run(1.3, lead)
    return least


def test_a_hand_led_into_the_chest_stops_before_it() -> None:
    loop = ClosedLoop(load_robot(), "hardware", 1)
    kept = loop.robot.tables.self_collision.distance
    assert reach_into_the_chest(loop) > 0.5 * kept
    assert loop.controller.near_pairs > 0
    assert loop.fall is None
    assert loop.command.qp_failures == 0


def test_without_a_table_it_touches() -> None:
    assert reach_into_the_chest(ClosedLoop(load_robot(**NOBODY), "hardware", 1)) < 0.0


class OneStep:
    """A single step of the left foot, onto where the right one is."""

    def __init__(self) -> None:
        self.steps: list[Step] = []
        self.asked = False

    def upcoming(self, soles: Sequence[SolePose]) -> Sequence[Step]:
        if not self.asked:
            self.asked = True
            x, y, z = (soles[1].position + np.array((0.0, 0.08, 0.0))).tolist()
            self.steps = [Step(0, LEFT, level_pose(x, y, z, 0.0), 0.05, 0.8, 0.6)]
        return self.steps

    def began(self, step: Step) -> None: ...

    def ended(self, step: Step) -> None:
        self.steps = []

    def rested(self) -> None: ...


@pytest.mark.parametrize("apart", [True, False])
def test_a_foot_sent_onto_the_other_comes_down_beside_it(apart: bool) -> None:
    loop = ClosedLoop(load_robot() if apart else load_robot(**NOBODY), "hardware", 0)
    loop.settle(0.3)
    loop.run(0.6)
    loop.controller.step_source = OneStep()
    model, segment, least = loop.plant.model, np.zeros(6), np.inf
    left, right = model.shape("l_foot"), model.shape("r_foot")
    until = loop.time + 2.4
    while loop.time < until:
        loop.step()
        least = min(least, mujoco.mj_geomDistance(model.mj, loop.plant.data, left, right, 1.0, segment))
    if apart:
        assert least > 0.005
        assert loop.command.qp_failures == 0
        assert loop.fall is None
    else:
        assert least < 0.0


def test_a_pair_that_the_model_does_not_have_is_told() -> None:
    with pytest.raises(ConfigurationError, match=r"self_collision\.pairs\.0: got 'l_tail'; expected a body of"):
        controller_model(load_robot(self_collision={"pairs": [("l_tail", "chest")]}))
