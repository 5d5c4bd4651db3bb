"""The experiment on the hand, from recordings of motions to its result: a base that gives way, and one that stays."""

import csv
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bifrost import Message
from harness import analysis_bag
from tests.thesis.test_end_effector import NOMINAL, REACH, ROBOT, swaying
from thesis.analysis.end_effector import Hand
from thesis.analysis.timeline import Motion, Timeline
from thesis.experiments import arm_session, end_effector
from thesis.experiments.arm_session import Session
from thesis.experiments.experiment import Options, Run
from thesis.experiments.table import BY_NAME
from thesis.report.results import FILE, Result
from valor.common.instance import Instance
from valor.common.messages import HandGoal, HandGoalStatus
from valor.common.topics import HAND_GOAL, HAND_GOAL_STATUS, Topic
from valor.valorctl.terminal.console import Interruption, Progress

FAR = np.array((0.03, -0.04, 0.0))  # from where the hand goes to where the second goal has it [m]
SHIFT = 7.8  # of the pelvis while the arm is out, as ``swaying`` has it [cm]


def led_messages(pelvis: Callable[[float], tuple[Any, float]]) -> Iterator[tuple[Topic[Any], Message]]:
    """As of a hand that is led to where the arm goes, and to a place that it does not reach; the left one elsewhere."""
    hand = Hand(ROBOT, "right")
    base, model = analysis_bag.HungRobot(ROBOT).base, ROBOT.nominal_posture.copy()
    wanted = []
    for goal, off in ((REACH, np.zeros(3)), (NOMINAL, FAR)):
        for joint, angle in goal.items():
            model[ROBOT.index[joint]] = angle
        _, there = hand.in_odom(model[None], base[None, :3], base[None, 3:])
        quaternion = Rotation.from_matrix(there.rotation[0]).as_quat()[[3, 0, 1, 2]]
        wanted.append((there.position[0] + off, quaternion))
    for at, (place, turn) in zip((1_000_000_000, 3_500_000_000), wanted, strict=True):
        yield HAND_GOAL, HandGoal(at, 1, True, "odom", place, turn)
        yield HAND_GOAL, HandGoal(at + 1, 0, True, "odom", np.zeros(3), turn)
        yield HAND_GOAL, HandGoal(at + 2, 1, True, "pelvis", np.zeros(3), turn)
    for at, side, state, reason in (
        (1_100_000_000, 1, "moving", ""), (3_000_000_000, 1, "reached", ""), (3_600_000_000, 1, "moving", ""),
        (4_500_000_000, 1, "out_of_reach", "50 mm left"), (4_550_000_000, 0, "idle", ""),
    ):  # fmt: skip
        yield HAND_GOAL_STATUS, HandGoalStatus(at, side, state, reason, 0.0, 0.0)
    yield from analysis_bag.simulate(ROBOT, pelvis)


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, Path]:
    """Of the system that holds the centre of mass, its base gives way; of this one's own way, it stays."""
    timeline = Timeline([Motion("forward", 1.0, 3.5, REACH), Motion("home", 3.5, 4.9, NOMINAL)])
    goals = Timeline([Motion("1 ahead", 1.0, 3.5, REACH), Motion("2 behind", 3.5, 4.9, NOMINAL)])
    asked: list[tuple[bool, str | None, str]] = []

    def record(
        run: Run, bag: Path, robot: Path | None = None, actuators: str | None = None, how: arm_session.Goals = "none"
    ) -> Session:
        asked.append((robot is not None, actuators, how))
        pelvis = analysis_bag.still if robot is None else swaying
        analysis_bag.write_messages(
            bag, led_messages(pelvis) if how == "poses" else analysis_bag.simulate(ROBOT, pelvis)
        )
        run.files.append(bag)
        return Session(ROBOT, timeline, goals, ["3 ahead"] if actuators else [])

    out = tmp_path_factory.mktemp("experiment")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(arm_session, "record", record)
        found, _ = BY_NAME["end-effector"].perform(
            Instance("nobody", out), Options(out, quick=True), Progress(), Interruption()
        )
    assert asked == [
        (True, None, "postures"), (False, None, "poses"), (True, arm_session.REAL_ARMS, "postures"),
    ]  # fmt: skip
    return found, out


def measured(result: Result) -> dict[str, Any]:
    return {measure.name: measure.value for measure in result.measures}


def test_what_the_base_does_is_distinguished_in_the_numbers(result: tuple[Result, Path]) -> None:
    numbers = measured(result[0])
    assert numbers["by the floating base, smallest at a pose"] == numbers["by the floating base, largest at a pose"]
    assert 0.8 * SHIFT < numbers["by the floating base, largest at a pose"] < 4.0 * SHIFT  # it turns, too
    assert numbers["by the floating base where the CoM goes with the arm, largest at a pose"] < 0.1
    assert numbers["share of the base in it"] == pytest.approx(1.0, abs=0.25)
    assert 0.1 < numbers["command to sensed, 99 of 100 moments"] <= numbers["command to sensed, largest"] < 10.0
    assert 8.0 < numbers["orientation at rest, largest angle"] < 16.0  # 0.2 rad
    assert numbers["real arms: from the goal at rest, largest"] == numbers["from the goal at rest, largest"]
    assert numbers["real arms: from set-points at rest, largest"] < 2.0


def test_the_bases_share_is_a_ratio_of_sums_and_not_a_mean_of_ratios() -> None:
    share = end_effector._share("share", np.array([0.01, 0.03]), np.array([0.02, 0.12]), "½", "why")
    assert share.value == pytest.approx(0.04 / 0.14)  # upside down it were 3.5; the ratios' mean is 0.375
    assert share.note == "sum over the poses by sum; of single poses 0.25–0.50; why"


def test_axes_that_are_logarithmic_are_said_to_be(result: tuple[Result, Path]) -> None:
    captions = {picture.reproduces: picture.caption for picture in result[0].pictures}
    assert captions["Figure 5.8"].endswith("fixed base. Axes are logarithmic beyond ±1 cm and beyond ±1 °.")
    assert "logarithmic" not in captions["Figure 5.9"] and "pale: the goal's arm" in captions["Figure 5.7"]


def test_arbitrary_goals_are_reported_by_way_and_side_or_with_the_reason(result: tuple[Result, Path]) -> None:
    found, out = result
    rows = {row[0]: row[1:] for row in found.tables[3].rows}
    assert [row[0] for row in rows.values()] == ["1"] * 6
    arm, by_base, whole, turned = (float(value.split(", ")[1]) for value in rows["as in the thesis, ahead"][1:5])
    assert arm < 2.0 and 0.8 * SHIFT < by_base < 4.0 * SHIFT and whole == pytest.approx(by_base, abs=2.0)
    assert 8.0 < turned < 16.0  # 0.2 rad
    assert float(rows["as in the thesis, behind"][2].split(", ")[1]) < 0.1 * by_base  # it is back
    ahead, behind = (rows[f"this system's own way, {where}"] for where in ("ahead", "behind"))
    assert (ahead[1], ahead[5], behind[5]) == ("–", "0", "1") and float(ahead[3].split(", ")[0]) < 2.0
    assert float(behind[3].split(", ")[0]) > 2.0
    numbers = measured(found)
    middle, most = (numbers[f"arbitrary goals, as in the thesis: from the goal at rest, {name}"]
                    for name in ("median", "largest"))  # fmt: skip
    assert most == pytest.approx(whole, abs=0.06) and middle < 0.9 * most  # of one far and one near
    reported = next(measure for measure in found.measures if measure.name == "arbitrary goals out of reach")
    assert reported.value == 2.0
    assert reported.note == "2 behind: 50 mm left; 3 ahead: refused (as in the thesis, real arms)"
    with open(out / "arbitrary_goals.csv") as file:
        written = list(csv.DictReader(file))
    assert [row["state"] for row in written] == ["", "", "reached", "out_of_reach", "", ""]
    assert (out / "arbitrary_goals.png").stat().st_size > 5_000


def test_tables_pictures_and_files_are_those_of_the_thesis(result: tuple[Result, Path]) -> None:
    found, out = result
    assert [[row[0] for row in table.rows] for table in found.tables[:3]] == [["forward", "home"]] * 3
    kept, ours, _ = ([float(value) for value in table.rows[0][1:5]] for table in found.tables[:3])
    assert kept[3] > 5.0 and max(map(abs, ours)) < 0.2
    assert [picture.reproduces for picture in found.pictures if picture.reproduces] == [
        "Figure 5.8", "Figure 5.9", "Figure 5.11", "Figure 5.12", "Figure 5.7", "Figure 5.10", "Figure 5.13",
        "Figure 5.14", "Figure 5.15",
    ]  # fmt: skip
    assert all((out / picture.file).stat().st_size > 5_000 for picture in found.pictures)
    assert Result.load(out / FILE) == found
    with open(out / "end_effector.csv") as file:
        rows = list(csv.DictReader(file))
    assert {row["behavior"] for row in rows} <= {"stand", "stand_manipulate"}
    for row in (rows[0], rows[len(rows) // 2], rows[-1]):
        parts = sum(float(row[f"{part}_x_m"]) for part in ("command", "tracking", "base"))
        assert float(row["total_x_m"]) == pytest.approx(parts, abs=5e-6)
