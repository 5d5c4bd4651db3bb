"""The search for getting up: falls and motions as the plant plays them, a search that improves, one that gives up."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest

from harness.generated_robot import Build
from harness.places import ROBOTS
from tests.unit.robot_setup.builds import made
from valor.common.arrays import FloatArray
from valor.get_up_planning.motions import OnFeet, OnHandsAndKnees, OnKnees, RollOver, Squat, StandUp, Throw
from valor.get_up_planning.plan import BENDS, ONWARD, freed, shortened, table
from valor.get_up_planning.rollouts import HEADING, Fallen, Rollouts, Target
from valor.get_up_planning.search import ROUNDS, SHORT, STARTS, TRIED, NoMotionFoundError, Search, find, tuned
from valor.robot.description import RobotDescription
from valor.robot.get_up_table import FILE, Posture, goals, load


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


def test_legs_that_lean_outward_fold_without_it(tmp_path: Path) -> None:
    robot = made(Build(ankle=0.26), tmp_path)
    stand_up = StandUp(Rollouts(robot))
    leg = [robot.index[name] for name in robot.tables.group("left_leg")]
    lean = [np.abs(target.goal[leg] - robot.nominal_posture[leg]) for target in stand_up.targets(stand_up.mean)]
    roll = int(np.abs(robot.nominal_posture[leg]).argsort()[-4])  # less than hip, knee and ankle bend
    nominal = abs(robot.nominal_posture[leg][roll])
    assert nominal > 0.05
    assert nominal > lean[0][roll] > lean[1][roll] > lean[2][roll] == 0.0


@pytest.mark.parametrize("name", ["escher", "thor"])
def test_a_robot_gets_up_over_its_knees_as_its_table_says(name: str) -> None:
    robot = rollouts(name)
    assert not Squat(robot).folds
    rise, search = motion(robot.robot, Posture.FACE), OnFeet(robot)
    lying = [fall for fall in robot.fallen(range(20, 26)) if fall.way is Posture.FACE]
    results = robot.play([(fall, rise) for fall in lying])
    assert [search.succeeded(states) for states in results].count(True) >= len(lying) - 1
    varied = [search.succeeded(states) for states in robot.play([(fall, rise) for fall in robot.varied(lying)])]
    assert varied.count(True) >= 0.5 * len(lying)
    assert not search.succeeded(results[0][:-3])


@pytest.mark.parametrize("name", ["escher", "thor"])
def test_a_robot_that_rolled_over_draws_up_its_hips_without_an_arm_below_it(name: str) -> None:
    robot = rollouts(name)
    over = RollOver(robot, motion(robot.robot, Posture.FACE)[:ONWARD])
    roll = motion(robot.robot, Posture.BACK)
    lying = [fall for fall in robot.fallen(range(20, 24)) if fall.way in over.start]
    results = over.play([(fall, roll) for fall in lying])
    assert [over.succeeded(states) for states in results].count(True) >= len(lying) - 1
    assert not over.succeeded([results[0][0]] * len(results[0]))


def motion(robot: RobotDescription, start: Posture) -> list[Target]:
    table = load(robot)
    assert table is not None
    (poses,) = [motion.poses for motion in table.motions if start in motion.start]
    return [
        Target(pose.name, goal, pose.duration, pose.hold, pose.balanced)
        for pose, goal in zip(poses, goals(robot, poses), strict=True)
    ]


def test_arms_turn_little_from_overhead_to_the_floor_ahead() -> None:
    robot = rollouts("escher")
    pitch = robot.robot.index["l_shoulder_pitch"]
    search = OnHandsAndKnees(robot)
    goals = [target.goal[pitch] for target in search.targets(search.mean)[1:]]
    assert goals[0] < -2.5 and (np.abs(np.diff(goals)) < 1.0).all()


@pytest.mark.parametrize("lean", [-0.06, 0.04])
def test_balance_brings_the_centre_of_mass_nearer_to_the_middle_of_the_soles(lean: float) -> None:
    robot = rollouts("escher")
    start, goal = standing(robot, robot.robot.nominal_posture), robot.robot.nominal_posture.copy()
    goal[[robot.robot.index[name] for name in robot.balance.joints]] += lean
    motions = [
        (start, [Target("lean", goal, 0.5, 0.5, balanced), Target("wait", goal, 0.1, 1.4, balanced)])
        for balanced in (False, True)
    ]
    for one, together in zip(motions, robot.play(motions), strict=True):  # each alone moves as among others
        assert all(map(np.array_equal, robot.play([one])[0], together))
    foot = robot.robot.tables.feet.left
    alone, balanced = (
        abs(robot.over_soles(states[-1])[0][0] - 0.5 * (foot.heel + foot.toe)) for states in robot.play(motions)
    )
    assert balanced < 0.7 * alone


def test_a_motion_is_shortened_to_what_it_needs() -> None:
    goal, reports = np.zeros(1), list[str]()
    poses = [Target(name, goal, 2.0, float(name == "rest")) for name in ("idle", "slow", "rest", "stiff", "last")]

    def count(poses: Sequence[Target], falls: int) -> int:
        slow = [pose for pose in poses if pose.name == "slow"]
        complete = "stiff" in [pose.name for pose in poses] and poses[-1].name == "last"
        return falls if slow and slow[0].duration >= 1.0 and complete else falls - 1

    def duration(poses: Sequence[Target]) -> float:
        return sum(max(pose.duration, 2.0 if pose.name == "stiff" else 0.0) for pose in poses)

    short = shortened(poses, count, duration, reports.append)
    times = [(pose.name, pose.duration) for pose in short]
    assert times == [("slow", 1.0), ("rest", 2.0), ("stiff", 2.0), ("last", 0.75)]
    assert reports[0] == "idle: left out" and "slow: 50% shorter" in reports


def test_a_throw_is_changed_alike_on_both_sides_but_for_its_end() -> None:
    robot = rollouts("escher")
    part = motion(robot.robot, Posture.FACE)[-4:]
    throw = Throw(robot, part)
    for same, pose in zip(throw.targets(throw.mean), part, strict=True):
        assert np.allclose(same.goal, pose.goal) and same.duration == pose.duration
    flexed = throw.targets(np.repeat((0.1, -0.2, 0.5), len(part)))
    joints = [robot.robot.index[f"{side}_{joint}_pitch"] for side in "lr" for joint in ("hip", "knee")]
    for pose, before in zip(flexed[:-1], part, strict=False):
        assert np.allclose((pose.goal - before.goal)[joints], (-0.1, -0.2, -0.1, -0.2), atol=1e-6)
        assert pose.duration == pytest.approx(1.5 * before.duration) and pose.balanced == before.balanced
    assert np.allclose(flexed[-1].goal, robot.robot.nominal_posture, atol=1e-3) and flexed[-1].hold == part[-1].hold


def test_knees_bend_as_frees_the_arms_from_most_falls(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = rollouts("thor")
    rise, roll = motion(robot.robot, Posture.FACE), motion(robot.robot, Posture.BACK)
    knees = [robot.robot.index[f"{side}_knee_pitch"] for side in "lr"]
    straighter = rise[0].goal[knees] - 0.2
    monkeypatch.setattr(Rollouts, "play", lambda _, motions: [[targets[0].goal] for _, targets in motions])
    monkeypatch.setattr(RollOver, "succeeded", lambda *_: True)
    monkeypatch.setattr(OnKnees, "succeeded", lambda _, states: np.allclose(states[-1][knees], straighter))
    falls = [Fallen(robot.model.mj, np.zeros(1), np.zeros(1), way) for way in (Posture.FACE, Posture.BACK)]
    reports: list[str] = []
    first, *others = freed(robot, rise, roll, falls, reports.append)
    assert np.allclose(first.goal[knees], straighter) and len(reports) == len(BENDS)
    assert all(np.allclose(a.goal, b.goal, atol=1e-3) for a, b in zip(others, rise[1:], strict=True))


def test_varied_falls_have_other_friction_and_damping() -> None:
    robot = rollouts("escher")
    falls = [Fallen(robot.model.mj, np.zeros(1), np.zeros(1), None)] * 2
    one, other = (fall.mj for fall in robot.varied(falls))
    for name in ("geom_friction", "dof_frictionloss", "actuator_biasprm"):
        nominal = getattr(robot.model.mj, name)
        ratios = [getattr(mj, name)[nominal != 0.0] / nominal[nominal != 0.0] for mj in (one, other)]
        assert all(((ratio >= 0.75) & (ratio <= 1.25)).all() for ratio in ratios)
        assert not np.allclose(*ratios) and not np.allclose(ratios[0], 1.0)
    assert (one.actuator_biasprm[:, 1] == robot.model.mj.actuator_biasprm[:, 1]).all()
    assert (one.body_mass == robot.model.mj.body_mass).all()


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
        return float(np.abs(states[-1] - 1.0).sum()) - float(np.sign(self.near))  # above 0 where nothing is near enough

    def succeeded(self, states: Sequence[FloatArray]) -> bool:
        return float(np.abs(states[-1] - 1.0).sum()) < self.near


@pytest.mark.parametrize("near", [0.3, -1.0])
def test_a_search_finds_what_there_is_or_gives_up_with_the_reason(monkeypatch: pytest.MonkeyPatch, near: float) -> None:
    monkeypatch.setattr(Rollouts, "play", lambda _, motions: [[targets[-1].goal] for _, targets in motions])
    monkeypatch.setattr(Rollouts, "duration", lambda *_: 0.1)
    falls = [Fallen(rollouts("escher").model.mj, np.zeros(1), np.zeros(1), None)] * (STARTS + 2)
    reports: list[str] = []
    if near > 0.0:
        (target,) = find(Reach(near), falls, 0, reports.append)
        assert np.abs(target.goal - 1.0).max() < 0.3 and "succeeds from 2 of 2 falls" in reports[-1]
        (target,) = tuned(Reach(near), falls, 0, reports.append)
        assert np.abs(target.goal - 1.0).max() < 0.3
    else:
        with pytest.raises(
            NoMotionFoundError, match="escher: the best motion found to a point succeeds from 0 of 2 falls"
        ):
            find(Reach(near), falls, 0, reports.append)
        assert sum(f" 1/{SHORT}:" in report for report in reports) == ROUNDS * TRIED  # every round restarts
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
