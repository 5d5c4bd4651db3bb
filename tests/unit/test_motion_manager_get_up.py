"""Getting up: what is refused, what gives up, and the way from the floor to Stand on the simulated robot."""

from dataclasses import dataclass, field
from math import cos, radians, sin
from pathlib import Path
from shutil import copytree, ignore_patterns

import numpy as np
import pytest

from harness.places import ROBOTS
from harness.robot_in_process import RobotInProcess
from valor.common.arrays import FloatArray
from valor.common.behaviors import Behavior
from valor.motion_manager.locomotion.get_up import ATTEMPTS, GetUp
from valor.robot.description import RobotDescription
from valor.robot.get_up_table import FILE, Balance, Posture, lying
from valor.robot.sole_balance import SoleBalance

ESCHER = RobotDescription.load(ROBOTS / "escher")
TABLE = """
roll: 45
balance: {joints: [l_ankle_pitch, r_ankle_pitch], gain: 0.6, limit: 0.15}
motions:
- from: [face]
  to: standing
  poses:
  - {name: bend the knees, duration: 1, pitch: [60, 120], joints: {l_knee_pitch: 1.5, r_knee_pitch: 1.5}}
  - {name: wait, duration: 0.5, hold: 0.5, pitch: [60, 120], joints: {}}
"""


@pytest.fixture
def get_up(tmp_path: Path) -> GetUp:
    """Get Up of a robot that stands once it has bent its knees."""
    folder = copytree(ROBOTS / "escher", tmp_path / "escher", ignore=ignore_patterns(FILE))
    (folder / FILE).write_text(TABLE)
    return GetUp(RobotDescription.load(folder))


@dataclass
class Lying:
    """As much of a RobotState as Get Up looks at."""

    pitch: float  # [deg]
    roll: float = 0.0
    rate: float = 0.0
    joint_position: FloatArray = field(default_factory=ESCHER.nominal_posture.copy)

    @property
    def pelvis_rotation_in_odom(self) -> FloatArray:
        p, r = radians(self.pitch), radians(self.roll)
        row = (-sin(p) * cos(r), sin(r), cos(p) * cos(r))
        return np.array([(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), row])

    @property
    def pelvis_angular_velocity_in_pelvis(self) -> FloatArray:
        return np.array([0.0, self.rate, 0.0])


@pytest.mark.parametrize(
    ("pitch", "roll", "way"),
    [
        (90.0, 0.0, Posture.FACE),
        (130.0, 20.0, Posture.FACE),
        (-90.0, 0.0, Posture.BACK),
        (-90.0, 45.0, Posture.RIGHT),
        (0.0, 90.0, Posture.RIGHT),
        (90.0, -60.0, Posture.LEFT),
        (-90.0, -45.0, Posture.LEFT),
        (0.0, 20.0, None),
        (-30.0, 0.0, None),
    ],
)
def test_how_it_lies_is_seen_from_the_attitude_of_its_pelvis(pitch: float, roll: float, way: Posture | None) -> None:
    state, get_up = Lying(pitch, roll), GetUp(ESCHER)
    assert lying(state.pelvis_rotation_in_odom[2]) is way
    reason = get_up.rejection(state)  # type: ignore[arg-type]
    assert reason == "" if way else "it does not lie" in reason and "face, right, left, back" in reason


def test_every_way_of_lying_leads_to_standing_and_the_sides_mirror_each_other() -> None:
    ways = GetUp(ESCHER).ways
    for start in ways:
        at = start
        for _ in ways:
            at = at if at is Posture.STANDING else ways[at].to
        assert at is Posture.STANDING
    left, right = (np.array(ways[side].goals) for side in (Posture.LEFT, Posture.RIGHT))
    knees = [[ESCHER.index[f"{side}_{joint}"] for side in "lr"] for joint in ("knee_pitch", "hip_roll")]
    for (one, other), sign in zip(knees, (1.0, -1.0), strict=True):
        assert np.allclose(left[:, one], sign * right[:, other]) and not np.allclose(left[:, one], sign * right[:, one])


def test_a_roll_that_fails_is_tried_over_the_other_side_and_not_for_ever() -> None:
    get_up, now, seen = GetUp(ESCHER), 0.0, list[object]()
    get_up.begin(Lying(-90.0), now)  # type: ignore[arg-type]
    while not get_up.failure and now < 120.0:
        now += 0.01
        get_up.update(Lying(-90.0), now)  # type: ignore[arg-type]
        if get_up.way is not None and (not seen or seen[-1] is not get_up.way):
            seen.append(get_up.way)
    assert len(seen) == ATTEMPTS and seen[0] is seen[2] is not seen[1]
    assert f"{ATTEMPTS} motions failed" in get_up.failure and "lies on its back; expected face" in get_up.failure


@pytest.mark.parametrize("rests", [True, False])
def test_a_robot_that_still_rocks_comes_to_rest_before_it_moves(get_up: GetUp, rests: bool) -> None:
    now = 0.0
    get_up.begin(Lying(90.0, rate=2.0), now)  # type: ignore[arg-type]
    assert get_up.way is None and "coming to rest: the pelvis rotates at 2.0 rad/s" in get_up.progress
    while get_up.way is None and not get_up.failure:
        now += 0.01
        assert now < 20.0
        get_up.update(Lying(90.0, rate=0.2 if rests and now > 1.0 else 2.0), now)  # type: ignore[arg-type]
    if rests:
        assert now < 2.0 and get_up.way is get_up.ways[Posture.FACE]
    else:
        assert "still rotates at 2.0" in get_up.failure


def test_a_robot_without_a_table_refuses(tmp_path: Path) -> None:
    robot = RobotDescription.load(copytree(ROBOTS / "thor", tmp_path / "thor", ignore=ignore_patterns(FILE)))
    assert "thor has no get_up.yaml" in GetUp(robot).rejection(Lying(90.0))  # type: ignore[arg-type]


@pytest.mark.parametrize(("pitch", "roll"), [(50.0, 0.0), (90.0, 50.0)])
def test_a_robot_that_is_not_where_a_pose_should_have_brought_it_goes_limp(
    get_up: GetUp, pitch: float, roll: float
) -> None:
    now = 0.0
    get_up.begin(Lying(90.0), now)  # type: ignore[arg-type]
    while not get_up.trouble and now < 10.0:
        now += 0.01
        get_up.update(Lying(pitch, roll), now)  # type: ignore[arg-type]
        assert not get_up.done
    assert get_up.way is None and (f"rolled {roll:.0f}°" if roll else "pitched 50°") in get_up.trouble
    assert "coming to rest" in get_up.progress and not get_up.failure


def test_from_face_down_to_stand() -> None:
    run = RobotInProcess(ESCHER, "hardware", seed=0)
    run.lie_face_down()
    assert "no transition" in run.ask(Behavior.STAND_PREP) and run.get_up() == ""
    assert (run.peak <= ESCHER.effort_limit + 1e-9).all() and run.stand() == ""


def test_a_robot_that_is_held_down_goes_limp_and_is_stopped() -> None:
    run = RobotInProcess(ESCHER, "ideal", seed=0)
    run.lie_face_down()
    chest = run.plant.model.body(ESCHER.tables.chest)
    run.plant.data.xfrc_applied[chest, 2] = -1500.0  # somebody stands on its back [N]
    assert run.ask(Behavior.GET_UP) == ""
    assert run.run_until(lambda: "coming to rest" in run.manager.fsm.reason, 20.0)
    run.peak[:] = 0.0
    run.step()
    assert run.behavior is Behavior.GET_UP and (run.peak < 0.2 * ESCHER.effort_limit).all()
    assert run.ask(Behavior.FALL) == "" and "no transition" in run.ask(Behavior.STAND)


def test_from_its_back_it_rolls_over_to_its_face() -> None:
    run = RobotInProcess(ESCHER, "hardware", seed=1)
    run.topple(Posture.BACK, seed=1)
    assert (state := run.manager.components.state) and lying(state.pelvis_rotation_in_odom[2]) is Posture.BACK
    assert run.ask(Behavior.GET_UP) == ""
    assert run.run_until(lambda: "to standing" in run.manager.fsm.reason, 8.0)


def test_on_its_soles_the_ankles_lean_it_back_to_the_middle() -> None:
    table = Balance(joints=["l_ankle_pitch", "r_ankle_pitch"], gain=0.6, limit=0.1)
    ankles = [ESCHER.index[name] for name in table.joints]

    def lean(*way: float) -> float:
        balance, position = SoleBalance(ESCHER, table), ESCHER.nominal_posture.copy()
        for i, ahead in enumerate(way):
            position = ESCHER.nominal_posture.copy()
            balance.lean(position, np.array([0.0, 0.025 + ahead, 0.5]), np.array([0.0, 2.0]), 1.0 + 0.002 * i)
        added = position - ESCHER.nominal_posture
        assert not np.delete(added, ankles).any() and added[ankles[0]] == added[ankles[1]]
        return float(added[ankles[0]])

    assert lean(0.0) == pytest.approx(0.0)
    assert lean(0.05) == pytest.approx(0.03)  # toes down: the CoP goes ahead
    assert lean(-0.05) == pytest.approx(-0.03)
    assert lean(*np.linspace(0.0, 0.05, 50)) > 0.04  # it is on its way ahead
    assert lean(1.0) == pytest.approx(table.limit)


def test_a_robot_that_sways_on_is_waited_for_and_given_up(get_up: GetUp) -> None:
    now = 0.0
    get_up.begin(Lying(90.0), now)  # type: ignore[arg-type]
    while "wait" not in get_up.progress:
        now += 0.01
        get_up.update(Lying(90.0), now)  # type: ignore[arg-type]
        assert not get_up.failure
    reached = now + 1.0
    while not get_up.trouble and now < 60.0:
        now += 0.01
        get_up.update(Lying(90.0, rate=1.0), now)  # type: ignore[arg-type]
    assert "after wait the pelvis still rotates at 1.0 rad/s" in get_up.trouble
    assert now == pytest.approx(reached + 2.0, abs=0.5)
    while not get_up.failure and now < 60.0:
        now += 0.01
        get_up.update(Lying(90.0, rate=1.0), now)  # type: ignore[arg-type]
    assert "still rotates at 1.0 rad/s" in get_up.failure
