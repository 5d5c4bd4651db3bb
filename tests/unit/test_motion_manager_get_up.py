"""Getting up: what is refused, what gives up, and the way from the floor to Stand on the simulated robot."""

from dataclasses import dataclass, field
from math import cos, radians, sin

import numpy as np
import pytest

from harness.places import ROBOTS
from harness.robot_in_process import RobotInProcess
from valor.common.arrays import FloatArray
from valor.common.behaviors import Behavior
from valor.motion_manager.locomotion.get_up import GetUp, SoleBalance
from valor.robot.description import RobotDescription
from valor.robot.get_up_table import Balance

ESCHER = RobotDescription.load(ROBOTS / "escher")


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
    ("state", "words"),
    [
        (Lying(-90.0), "face-down only: the pelvis is pitched -90°"),
        (Lying(90.0, roll=60.0), "rolled 60°; expected 60 to 120° and at most 30°"),
        (Lying(0.0), "pitched 0°"),
        (Lying(90.0, rate=2.0), "does not lie still"),
    ],
)
def test_from_elsewhere_than_face_down_it_is_refused(state: Lying, words: str) -> None:
    assert words in GetUp(ESCHER).rejection(state)  # type: ignore[arg-type]
    assert GetUp(ESCHER).rejection(Lying(90.0)) == ""  # type: ignore[arg-type]


def test_a_robot_without_a_table_refuses() -> None:
    thor = RobotDescription.load(ROBOTS / "thor")
    assert "thor has no get_up.yaml" in GetUp(thor).rejection(Lying(90.0))  # type: ignore[arg-type]


@pytest.mark.parametrize(("pitch", "roll"), [(20.0, 0.0), (90.0, 45.0)])
def test_a_robot_that_is_not_where_a_pose_should_have_brought_it_gives_up(pitch: float, roll: float) -> None:
    get_up, now = GetUp(ESCHER), 0.0
    get_up.begin(Lying(90.0), now)  # type: ignore[arg-type]
    while not get_up.failure and now < 60.0:
        now += 0.01
        get_up.update(Lying(pitch, roll), now)  # type: ignore[arg-type]
        assert not get_up.done
    assert f"{roll:.0f}°" in get_up.failure if roll else "pitched 20°" in get_up.failure
    assert now < 10.0


def test_from_face_down_to_stand() -> None:
    run = RobotInProcess(ESCHER, "hardware", seed=0)
    run.lie_face_down()
    assert "no transition" in run.ask(Behavior.STAND_PREP) and run.get_up() == ""
    assert (run.peak <= ESCHER.effort_limit + 1e-9).all() and run.stand() == ""


def test_a_robot_that_is_held_down_gives_up_limp() -> None:
    run = RobotInProcess(ESCHER, "ideal", seed=0)
    run.lie_face_down()
    chest = run.plant.model.body(ESCHER.tables.chest)
    run.plant.data.xfrc_applied[chest, 2] = -1500.0  # somebody stands on its back [N]
    reason = run.get_up()
    assert run.behavior is Behavior.FALL
    assert "given up" in reason
    run.peak[:] = 0.0
    run.step()
    assert (run.peak < 0.2 * ESCHER.effort_limit).all() and "no transition" in run.ask(Behavior.STAND)


@dataclass
class Squatting:
    """As much of a RobotState as the balance on the soles looks at: heading to y, the CoM ahead of their middle."""

    ahead: float  # [m]
    sole_positions_in_odom: FloatArray = field(default_factory=lambda: np.array([[2.0, 3.0, 0.0], [2.2, 3.0, 0.0]]))
    sole_rotations_in_odom: FloatArray = field(
        default_factory=lambda: np.tile([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], (2, 1, 1))
    )

    @property
    def com_in_odom(self) -> FloatArray:
        return np.array([2.1, 3.025 + self.ahead, 0.5])


def test_on_its_soles_the_ankles_lean_it_back_to_the_middle() -> None:
    table = Balance(joints=["l_ankle_pitch", "r_ankle_pitch"], gain=0.6, limit=0.1)
    ankles = [ESCHER.index[name] for name in table.joints]

    def lean(*way: float) -> float:
        balance, position = SoleBalance(ESCHER, table), ESCHER.nominal_posture.copy()
        for i, ahead in enumerate(way):
            position = ESCHER.nominal_posture.copy()
            balance.lean(position, Squatting(ahead), 1.0 + 0.002 * i)  # type: ignore[arg-type]
        added = position - ESCHER.nominal_posture
        assert not np.delete(added, ankles).any() and added[ankles[0]] == added[ankles[1]]
        return float(added[ankles[0]])

    assert lean(0.0) == pytest.approx(0.0)
    assert lean(0.05) == pytest.approx(0.03)  # toes down: the CoP goes ahead
    assert lean(-0.05) == pytest.approx(-0.03)
    assert lean(*np.linspace(0.0, 0.05, 50)) > 0.04  # it is on its way ahead
    assert lean(1.0) == pytest.approx(table.limit)


def test_a_robot_that_sways_on_is_waited_for_and_given_up() -> None:
    get_up, now = GetUp(ESCHER), 0.0
    get_up.begin(Lying(90.0), now)  # type: ignore[arg-type]
    while "on all fours" not in get_up.progress:
        now += 0.01
        get_up.update(Lying(90.0), now)  # type: ignore[arg-type]
        assert not get_up.failure
    reached = now + 2.2
    while not get_up.failure and now < 60.0:
        now += 0.01
        get_up.update(Lying(90.0, rate=1.0), now)  # type: ignore[arg-type]
    assert "after on all fours the pelvis still rotates at 1.0 rad/s" in get_up.failure
    assert now == pytest.approx(reached + 2.0, abs=0.5)
