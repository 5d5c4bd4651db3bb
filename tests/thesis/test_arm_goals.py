"""Arbitrary goals of an arm: of a seed, where they are asked for, touching nothing; an arm that has none reports it."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from harness.limbs import cut
from harness.places import ROBOTS
from thesis.experiments import arbitrary_goals
from thesis.experiments.arm_goals import AHEAD, BEHIND, HEIGHTS, INSIDE, OUTSIDE, ArmGoal, ArmGoals
from valor.common.errors import ValorError
from valor.robot.description import RobotDescription
from valor.robot.model import full_model
from valor.robot.tables import Side

ESCHER, THOR = (RobotDescription.load(ROBOTS / name) for name in ("escher", "thor"))


class Whole:
    def __init__(self, robot: RobotDescription, side: Side) -> None:
        self._robot, self._side = robot, side
        self._model = full_model(robot, "collision")
        self._data = mujoco.MjData(self._model.mj)

    def touches(self, posture: np.ndarray) -> bool:
        """Return whether any part touches another; it is there afterwards."""
        self._data.qpos[:] = self._model.nominal_qpos()
        self._data.qpos[:7] = (1.0, -2.0, 0.9, np.cos(0.4), 0.0, 0.0, np.sin(0.4))
        for joint, angle in zip(self._robot.joints, posture, strict=True):
            self._data.joint(joint).qpos[0] = angle
        mujoco.mj_forward(self._model.mj, self._data)
        return bool(self._data.ncon)

    @property
    def hand(self) -> tuple[np.ndarray, np.ndarray]:
        """In the base."""
        base = self._data.body(self._robot.tables.base)
        site = self._data.site(getattr(self._robot.tables.hands, self._side).site)
        turn = base.xmat.reshape(3, 3)
        return turn.T @ (site.xpos - base.xpos), turn.T @ site.xmat.reshape(3, 3)


def waist_turned(robot: RobotDescription) -> np.ndarray:
    posture = robot.nominal_posture.copy()
    posture[robot.index[robot.tables.group("torso")[0]]] += 0.3
    return posture


@pytest.mark.parametrize("robot", [ESCHER, THOR], ids=lambda robot: robot.name)
@pytest.mark.parametrize("side", ["left", "right"])
def test_a_goal_is_within_reach_and_the_hand_is_there(robot: RobotDescription, side: Side) -> None:
    goals, arm, whole = ArmGoals(robot, 3), robot.group_indices(f"{side}_arm"), Whole(robot, side)
    posture = waist_turned(robot)
    for i in range(12):
        goal = goals.draw(side, posture, ahead=i % 2 == 0)
        assert (goal.joints >= robot.lower[arm] + INSIDE).all() and (goal.joints <= robot.upper[arm] - INSIDE).all()
        posture[arm] = goal.joints
        assert not whole.touches(posture)
        place, turn = whole.hand
        np.testing.assert_allclose(goal.position, place, atol=1e-9)
        np.testing.assert_allclose(goal.rotation, turn, atol=1e-9)
        assert place[0] >= AHEAD if i % 2 == 0 else place[0] <= BEHIND
        assert HEIGHTS[0] < place[2] < HEIGHTS[1]
        assert place[1] * (1.0 if side == "left" else -1.0) > OUTSIDE


def test_a_seed_decides() -> None:
    def drawn(seed: int) -> list[ArmGoal]:
        goals = ArmGoals(ESCHER, seed)
        return [goals.draw("right", ESCHER.nominal_posture) for _ in range(3)]

    for one, same, other in zip(drawn(1), drawn(1), drawn(2), strict=True):
        np.testing.assert_array_equal(one.joints, same.joints)
        assert np.abs(one.joints - other.joints).max() > 0.01


@pytest.mark.parametrize("robot", [ESCHER, THOR], ids=lambda robot: robot.name)
def test_goals_go_ahead_and_behind_in_turn_by_ways_on_which_nothing_touches(robot: RobotDescription) -> None:
    goals, whole = arbitrary_goals.drawn(robot, 3, 30), Whole(robot, "right")
    assert [goal.name for goal in goals[:3]] == ["1 ahead", "2 behind", "3 ahead"]
    posture = robot.nominal_posture.copy()
    for name, angle in robot.tables.arm_presets["home"]["right"].items():
        posture[robot.index[name]] = angle
    for goal in goals:
        there = posture.copy()
        for name, angle in goal.joints.items():
            there[robot.index[name]] = angle
        assert not any(whole.touches(posture + share * (there - posture)) for share in np.linspace(0.05, 1.0, 20))
        assert whole.hand[0][0] >= AHEAD if goal.name.endswith("ahead") else whole.hand[0][0] <= BEHIND
        posture = there


def test_an_arm_without_goals_reports_it(tmp_path: Path) -> None:
    with pytest.raises(ValorError, match="has no right arm with a hand"):
        ArmGoals(cut(ESCHER, tmp_path / "cut", "right_arm"), 0).draw("right", ESCHER.nominal_posture)
