"""Latencies of the three pathways, where every delay is known."""

from pathlib import Path

import numpy as np
import pytest

from harness.places import ROBOTS
from tests.thesis import pathway_bag as known
from thesis.analysis import pathway_plots
from thesis.analysis.conversions import conversions
from thesis.analysis.pathways import Latencies, Pathway, Segment
from valor.analysis.reading.bag import Bag
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(ROBOTS / "escher")


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Latencies:
    path = tmp_path_factory.mktemp("bag") / "pathways.mcap"
    known.write(path, ROBOT)
    return Latencies.of(Bag(path), ROBOT)


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> Latencies:
    path = tmp_path_factory.mktemp("bag") / "pathways.mcap"
    known.write(path, ROBOT, driven=True)
    return Latencies.of(Bag(path), ROBOT)


@pytest.mark.parametrize(
    ("name", "expected", "count"),
    [
        ("Reference → VEC", known.RESPONSE, 2),
        ("VEC → MSetpoint", known.TO_SETPOINT, 1500),
        ("VEC → Motor", known.FOLLOWED * known.PERIOD + known.TO_MOTOR, 1500),
        ("Motor → HDT Cmd.", (known.OBEYED - 1) * known.PERIOD - known.TO_MOTOR, 2998),
        ("HDT Cmd. → Prop.", known.PERIOD, 2998),
        ("Prop. → JS", known.TO_STATES, 1500),
        ("Mode change cmd.", known.CHANGE, 2),
        ("Mode change reported", known.REPORT, 2),
    ],
)
def test_every_segment_is_found(found: Latencies, name: str, expected: float, count: int) -> None:
    segment = found[name]
    assert len(segment.by_stamps) == count
    # An update of the VRC comes every 4 ms, a state every 2 ms: events are seen at the next one.
    assert segment.mean == pytest.approx(expected, abs=0.0045 if count == 2 else 0.0003)


def test_a_driver_s_messages_name_what_they_carry(driven: Latencies, found: Latencies) -> None:
    assert driven.driven
    assert not found.driven
    carried, acted = driven["Motor → HDT Cmd."], driven["HDT Cmd. → Prop."]
    assert len(carried.by_stamps) == 600 and carried.by_stamps == pytest.approx(known.TO_DRIVER, abs=2e-6)
    # Its positions come in a later Proprioceptor than the next; at rest any has them.
    left = known.TO_MOTOR + known.TO_DRIVER
    assert len(acted.by_stamps) >= 595
    following = np.ceil((left + known.ACTED) / known.PERIOD) * known.PERIOD - left
    at = acted.at - driven.time[0]
    moving = np.any([(at > asked + 0.2) & (at < asked + 1.0) for asked in known.MOTIONS], axis=0)
    received = following + known.HANDED_ON * known.PERIOD
    assert moving.sum() >= 150 and acted.by_stamps[moving] == pytest.approx(received, abs=2e-6)
    assert acted.by_stamps[at < known.MOTIONS[0]] == pytest.approx(following, abs=2e-6)
    late = known.PLANT + known.OBEYED * known.PERIOD - known.TO_MOTOR - known.TO_DRIVER
    assert acted.by_correlation.mean() == pytest.approx(late, abs=0.0015)


def test_the_first_milliradian_is_later_than_the_messages_by_the_motion_s_own_beginning(found: Latencies) -> None:
    first = found.first
    assert len(first.vec) == 2 and (first.motor - first.vec).mean() == pytest.approx(known.THROUGH, abs=0.003)
    late = known.OBEYED * known.PERIOD - known.TO_MOTOR + known.PLANT
    assert (first.measured - first.motor).mean() == pytest.approx(late, abs=0.003)


def test_the_sums_go_from_end_to_end_and_count_nothing_twice(found: Latencies, tmp_path: Path) -> None:
    sums = {pathway.name: pathway for pathway in found.pathways}
    assert sums["proprioception"].mean == found["Prop. → JS"].mean
    assert [segment.name for segment in sums["joint command"].segments] == [
        "Reference → VEC", "VEC → Motor", "Motor → HDT Cmd.", "HDT Cmd. → Prop.",
    ]  # fmt: skip
    whole = known.RESPONSE + (known.FOLLOWED + known.OBEYED) * known.PERIOD  # no way counts twice
    assert sums["joint command"].mean == pytest.approx(whole, abs=0.005)
    few = np.array([0.001] * 9 + [0.1])  # less a standard deviation, the mean would be below zero
    seldom = Segment("seldom", "robot", few, np.zeros(10))
    assert seldom.interval[0] == 0.001 and Pathway("twice", (seldom, seldom)).interval == pytest.approx((0.002, 0.101))
    lag, stamps = found["HDT Cmd. → Prop."].by_correlation.mean(), found["Reference → VEC"].mean
    behind = stamps + found["VEC → Motor"].by_correlation.mean() + found["Motor → HDT Cmd."].mean + lag
    assert sums["joint command"].behind == pytest.approx(behind)
    for file in (
        pathway_plots.bars({"ideal": found, "hardware": found}, tmp_path / "bars.png"),
        pathway_plots.over_time({"ideal": found, "hardware": found}, tmp_path / "over_time.png"),
        pathway_plots.sums({"ideal": found}, dict.fromkeys(sums, "1"), tmp_path / "sums.png"),
    ):
        assert file.stat().st_size > 5_000


def test_runs_follow_one_another_and_keep_their_samples(found: Latencies, driven: Latencies) -> None:
    both = Latencies.together([found, driven])
    lasted = found.time[-1] - found.time[0]
    states = both["Prop. → JS"]
    assert len(states.by_stamps) == 3000 and states.mean == pytest.approx(found["Prop. → JS"].mean, rel=1e-3)
    assert states.at[1500] - states.at[0] == pytest.approx(lasted) and both.time[0] == 0.0
    assert both.time[-1] == pytest.approx(2.0 * lasted) and np.all(np.diff(both.time) >= 0.0)
    assert both.behaviors(states)[[1, 1501]].tolist() == ["stand", "stand"]
    assert len(both.first.vec) == 4 and len(both["VEC → Motor"].by_correlation) == 4


def test_a_conversion_costs_at_most_what_its_transport_leaves(found: Latencies) -> None:
    floors = {"ros": np.array([4e-4, 2e-4, 9e-4]), "bifrost": np.array([3e-4, 1e-4, 4e-4])}
    costs = {each.segment.name: each for each in conversions(found, floors)}
    states = costs["Prop. → JS"]
    assert states.transport == "bifrost" and states.mean == pytest.approx(known.TO_STATES - 1e-4, abs=1e-6)
    assert states.median == pytest.approx(known.TO_STATES - 1e-4, abs=1e-6)
    mode = costs["Mode change cmd."]
    assert (mode.transport, costs["Reference → VEC"].transport) == ("ros", "ros")
    assert mode.mean == pytest.approx(found["Mode change cmd."].mean - 2e-4, abs=1e-9)
    assert {each.segment.where for each in costs.values()} == {"VRC", "Motion System"}  # a mode is changed by both
