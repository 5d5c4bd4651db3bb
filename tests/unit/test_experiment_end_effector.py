"""The experiment on the hand, from recordings of motions to its result: a base that gives way, and one that stays."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import pytest

from harness import analysis_bag
from tests.unit.test_analysis_end_effector import NOMINAL, REACH, ROBOT, swaying
from valor.analysis.results import Result
from valor.analysis.timeline import Motion, Timeline
from valor.common.instance import Instance
from valor.robot.description import RobotDescription
from valor.valorctl.console import Progress
from valor.valorctl.experiments import arm_session
from valor.valorctl.experiments.experiment import Options, Run
from valor.valorctl.experiments.table import BY_NAME
from valor.valorctl.interruption import Interruption

SHIFT = 7.8  # of the pelvis while the arm is out, as ``swaying`` has it [cm]


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, Path]:
    """Of the system that holds the centre of mass, its base gives way; of this one's own way, it stays."""
    timeline = Timeline([Motion("forward", 1.0, 3.5, REACH), Motion("home", 3.5, 4.9, NOMINAL)])
    asked: list[tuple[bool, str | None]] = []

    def record(
        run: Run, bag: Path, robot: Path | None = None, actuators: str | None = None
    ) -> tuple[Timeline, RobotDescription]:
        asked.append((robot is not None, actuators))
        analysis_bag.write(bag, ROBOT, pelvis=analysis_bag.still if robot is None else swaying)
        run.files.append(bag)
        return timeline, ROBOT

    out = tmp_path_factory.mktemp("experiment")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(arm_session, "record", record)
        found, _ = BY_NAME["end-effector"].perform(
            Instance("nobody", out), Options(out, quick=True), Progress(), Interruption()
        )
    assert asked == [(True, None), (False, None), (True, arm_session.REAL_ARMS)]
    return found, out


def measured(result: Result) -> dict[str, Any]:
    return {measure.name: measure.value for measure in result.measures}


def test_what_the_base_does_is_told_apart_in_the_numbers(result: tuple[Result, Path]) -> None:
    numbers = measured(result[0])
    assert numbers["by the floating base, smallest at a pose"] == numbers["by the floating base, largest at a pose"]
    assert 0.8 * SHIFT < numbers["by the floating base, largest at a pose"] < 4.0 * SHIFT  # it turns, too
    assert numbers["by the floating base where the CoM goes with the arm, largest at a pose"] < 0.1
    assert numbers["share of the base in it"] == pytest.approx(1.0, abs=0.25)
    assert 0.1 < numbers["command to sensed, 99 of 100 moments"] <= numbers["command to sensed, largest"] < 10.0
    assert 8.0 < numbers["orientation at rest, largest angle"] < 16.0  # 0.2 rad
    assert numbers["real arms: from the goal at rest, largest"] == numbers["from the goal at rest, largest"]
    assert numbers["real arms: from set-points at rest, largest"] < 2.0


def test_tables_pictures_and_files_are_those_of_the_thesis(result: tuple[Result, Path]) -> None:
    found, out = result
    assert [[row[0] for row in table.rows] for table in found.tables] == [["forward", "home"]] * 3
    kept, ours, _ = ([float(value) for value in table.rows[0][1:5]] for table in found.tables)
    assert kept[3] > 5.0 and max(map(abs, ours)) < 0.2
    assert [picture.reproduces for picture in found.pictures if picture.reproduces] == [
        "Figure 5.8", "Figure 5.9", "Figure 5.11", "Figure 5.12", "Figures 5.7, 5.10", "Figure 5.13", "Figure 5.14",
        "Figure 5.15",
    ]  # fmt: skip
    assert all((out / picture.file).stat().st_size > 5_000 for picture in found.pictures)
    assert Result.load(out) == found
    with open(out / "end_effector.csv") as file:
        rows = list(csv.DictReader(file))
    assert {row["behavior"] for row in rows} <= {"stand", "stand_manipulate"}
    assert float(rows[1]["time_s"]) - float(rows[0]["time_s"]) == pytest.approx(0.01, abs=1e-4)
    for row in (rows[0], rows[len(rows) // 2], rows[-1]):
        for axis in "xyz":
            parts = sum(float(row[f"{part}_{axis}_m"]) for part in ("command", "tracking", "base"))
            assert float(row[f"total_{axis}_m"]) == pytest.approx(parts, abs=5e-6)
