"""Latencies of the three pathways, where every delay is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from harness import pathway_bag as known
from harness.places import ROBOTS
from valor.analysis import pathway_plots
from valor.analysis.bag import Bag
from valor.analysis.pathways import Latencies
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(ROBOTS / "escher")


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Latencies:
    path = tmp_path_factory.mktemp("bag") / "pathways.mcap"
    known.write(path, ROBOT)
    return Latencies.of(Bag(path), ROBOT)


@pytest.mark.parametrize(
    ("name", "expected", "count"),
    [
        ("Reference → VEC", known.RESPONSE, 2),
        ("VEC → MSetpoint", known.TO_SETPOINT, 1500),
        ("VEC → Motor", known.THROUGH, 2),
        ("Motor → HDT Cmd.", known.OBEYED * known.PERIOD - known.TO_MOTOR, 2998),
        ("HDT Cmd. → Prop.", known.PLANT, 2),
        ("Prop. → JS", known.TO_STATES, 1500),
        ("Mode change cmd.", known.CHANGE, 2),
        ("Mode change reported", known.REPORT, 2),
    ],
)
def test_every_segment_is_found(found: Latencies, name: str, expected: float, count: int) -> None:
    segment = found[name]
    assert len(segment.samples) == count
    # An update of the VRC comes every 4 ms, a state every 2 ms: events are seen at the next one.
    assert segment.mean == pytest.approx(expected, abs=0.0045 if count == 2 and len(segment.by_stamps) else 0.0006)


def test_every_latency_knows_when_and_in_which_behavior_it_was_met(found: Latencies) -> None:
    for segment in found.segments:
        assert len(segment.at) == len(segment.samples)
        assert found.time[0] - known.PERIOD <= segment.at.min() <= segment.at.max() <= found.time[-1]
    before = found.behaviors(found["Mode change cmd."])
    after = found.behaviors(found["Mode change reported"])
    assert all(before != after)


def test_both_methods_agree_where_both_can_be_had(found: Latencies) -> None:
    segment = found["VEC → MSetpoint"]
    assert len(segment.by_correlation) == 2
    assert segment.by_correlation.mean() == pytest.approx(segment.by_stamps.mean(), abs=0.0004)
    assert not len(found["Prop. → JS"].by_correlation)  # joint states that do not move tell no delay


def test_the_sums_go_from_end_to_end_and_count_nothing_twice(found: Latencies, tmp_path: Path) -> None:
    sums = {pathway.name: pathway for pathway in found.pathways}
    assert sums["proprioception"].mean == found["Prop. → JS"].mean
    assert [segment.name for segment in sums["joint command"].segments] == [
        "Reference → VEC", "VEC → Motor", "Motor → HDT Cmd.", "HDT Cmd. → Prop.",
    ]  # fmt: skip
    whole = known.RESPONSE + known.THROUGH + known.OBEYED * known.PERIOD - known.TO_MOTOR + known.PLANT
    assert sums["joint command"].mean == pytest.approx(whole, abs=0.005)
    assert sums["mode change"].deviation == pytest.approx(
        np.hypot(found["Mode change cmd."].deviation, found["Mode change reported"].deviation)
    )
    for file in (
        pathway_plots.bars({"ideal": found, "hardware": found}, tmp_path / "bars.png"),
        pathway_plots.over_time({"ideal": found, "hardware": found}, tmp_path / "over_time.png"),
        pathway_plots.sums({"ideal": found}, dict.fromkeys(sums, "1"), tmp_path / "sums.png"),
    ):
        assert file.stat().st_size > 5_000
