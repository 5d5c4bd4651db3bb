"""The search for getting up: falls and motions as the plant plays them, a search that improves, one that gives up."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest

from harness.places import ROBOTS
from valor.common.arrays import FloatArray
from valor.get_up_planning.plan import table
from valor.get_up_planning.rollouts import HEADING, Fallen, Rollouts, Target
from valor.get_up_planning.search import NoMotionFoundError, RollOver, Search, Squat, StandUp, find
from valor.robot.description import RobotDescription
from valor.robot.get_up_table import FILE, Posture, load


@cache
def rollouts(name: str) -> Rollouts:
    return Rollouts(RobotDescription.load(ROBOTS / name))


def standing(robot: Rollouts, posture: FloatArray) -> Fallen:
    """A robot on its soles in a posture."""
    mj, data = robot.model.mj, mujoco.MjData(robot.model.mj)
    data.qpos[:] = robot.model.nominal_qpos()
    data.qpos[robot.model.qpos] = posture
    mujoco.mj_kinematics(mj, data)
    foot = robot.robot.tables.feet.left
    rotation = data.site(foot.sole).xmat.reshape(3, 3)
    pitch = np.arctan2(rotation[2, 0], rotation[0, 0])
    data.qpos[3:7] = (np.cos(pitch / 2), 0.0, np.sin(pitch / 2), 0.0)
    mujoco.mj_kinematics(mj, data)
    data.qpos[2] -= data.site(foot.sole).xpos[2]
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.empty(mujoco.mj_stateSize(mj, kind))
    mujoco.mj_getState(mj, data, state, kind)
    return Fallen(mj, state, posture, None)


@pytest.mark.parametrize("name", ["escher", "thor"])
def test_a_deep_squat_balances_on_the_soles(name: str) -> None:
    robot = rollouts(name)
    squat = Squat(robot)
    goal = squat.targets(squat.mean)[-1]
    (states,) = robot.play([(standing(robot, goal.goal), [Target("squat", goal.goal, 0.2, 0.2)])])
    assert squat.succeeded(states) and robot.joints(states[-1])[squat.knee] > 2.0


def test_a_robot_falls_limp_to_every_side_and_holds_what_it_is_given() -> None:
    robot = rollouts("escher")
    falls = robot.fallen(range(2))
    assert len(falls) == 2 * len(HEADING) and {fall.way for fall in falls} > {Posture.FACE}
    assert all(fall.way and 0.0 < fall.state[3] < 0.5 for fall in falls)
    goal = robot.robot.nominal_posture
    ((state,),) = robot.play([(falls[0], [Target("nominal", goal, 1.0, 0.5)])])
    assert np.abs(robot.joints(state) - goal).max() < 0.3  # it lies on some


class Reach(Search):
    """A cost that needs no simulation: the distance from a point, and whether that is reached."""

    start, to = (None,), "a point"

    def __init__(self, near: float) -> None:
        super().__init__(rollouts("escher"))
        self.mean, self.spread, self.near = np.zeros(3), np.full(3, 0.5), near
        self.lower, self.upper = np.full(3, -2.0), np.full(3, 2.0)

    def targets(self, vector: FloatArray) -> list[Target]:
        return [Target("point", vector, 0.1)]

    def cost(self, states: Sequence[FloatArray]) -> float:
        return float(np.abs(states[-1] - 1.0).sum()) - 1.0

    def succeeded(self, states: Sequence[FloatArray]) -> bool:
        return self.cost(states) < self.near - 1.0


@pytest.mark.parametrize("near", [0.3, -1.0])
def test_a_search_finds_what_there_is_or_gives_up_with_the_reason(monkeypatch: pytest.MonkeyPatch, near: float) -> None:
    monkeypatch.setattr(Rollouts, "play", lambda _, motions: [[targets[-1].goal] for _, targets in motions])
    falls = [Fallen(rollouts("escher").model.mj, np.zeros(1), np.zeros(1), None)] * 5
    reports: list[str] = []
    if near > 0.0:
        (target,) = find(Reach(near), falls, 0, reports.append)
        assert np.abs(target.goal - 1.0).max() < 0.3 and "succeeds from 2 of 2 falls" in reports[-1]
    else:
        with pytest.raises(
            NoMotionFoundError, match="escher: the best motion found to a point succeeds from 0 of 2 falls"
        ):
            find(Reach(near), falls, 0, reports.append)
        with pytest.raises(NoMotionFoundError, match="2 falls to search"):
            find(Reach(near), falls[:2], 0, reports.append)


def test_a_table_of_motions_is_one_that_get_up_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = rollouts("escher")
    squat, stand, roll = (kind(robot) for kind in (Squat, StandUp, RollOver))
    lying = [standing(robot, squat.targets(squat.mean)[-1].goal)]
    monkeypatch.setattr(StandUp, "succeeded", lambda *_: True)
    rise = squat.targets(squat.mean) + stand.targets(stand.mean)
    text = table(robot, lying, rise, roll.targets(roll.mean))
    for file in (ROBOTS / "escher").iterdir():
        (tmp_path / file.name).symlink_to(file)
    (tmp_path / FILE).unlink()
    (tmp_path / FILE).write_text(text)
    read = load(RobotDescription.load(tmp_path))
    assert read is not None and [motion.to for motion in read.motions] == [Posture.STANDING, Posture.FACE]
    assert [pose.name for pose in read.motions[0].poses if pose.balanced] == ["squat", "rise", "straighten", "upright"]
