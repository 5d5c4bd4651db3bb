"""Defaults of another size: ESCHER's, as a robot of that size would have them."""

from __future__ import annotations

from pathlib import Path

import pytest

from harness.places import ROBOTS
from valor.common.errors import ConfigurationError
from valor.common.table import Table
from valor.robot.description import RobotDescription
from valor.robot.motion_tables import Footsteps, PelvisMotion, SelfCollision, Walking
from valor.robot.size import ESCHER, Size, completed, factors
from valor.whole_body.tuning_tables import Disturbance, FallDetection, HandMotion, Tuning, WholeBody

QUARTER = factors(Size(leg=ESCHER.leg / 4, mass=ESCHER.mass / 10), 0.07425 / 2)


def robot(folder: Path, *changes: tuple[str, str]) -> RobotDescription:
    """ESCHER with texts of its robot.yaml replaced."""
    text = (ROBOTS / "escher" / "robot.yaml").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "robot.yaml").write_text(text)
    (folder / "model.xml").symlink_to(ROBOTS / "escher" / "model.xml")
    return RobotDescription.load(folder)


def test_eschers_are_the_defaults_to_the_last_bit() -> None:
    escher = RobotDescription.load(ROBOTS / "escher")
    tables, tuning = escher.tables, escher.read(Tuning)
    assert (tables.walking, tables.pelvis, tables.footsteps) == (Walking(), PelvisMotion(), Footsteps())
    assert tables.self_collision == SelfCollision(pairs=tables.self_collision.pairs)
    assert tuning == Tuning()
    assert set(factors(ESCHER, 0.07425).values()) == {1.0}


def test_froudes_number_stays() -> None:
    f = QUARTER
    assert f["length"] == 0.25
    assert f["speed"] ** 2 / f["length"] == 1
    assert f["time"] * f["speed"] == f["length"]
    assert (f["time"] * f["rate"], f["length"] * f["squared_rate"], f["length"] ** 2 * f["per_area"]) == (1, 1, 1)
    assert (f["force"], f["sole"]) == (pytest.approx(0.1), 0.5)


@pytest.mark.parametrize(
    ("kind", "key", "expected"),
    [
        (Walking, "swing_duration", 0.3),
        (Walking, "max_forward_speed", 0.6),
        (Walking, "touchdown_force", 3.0),
        (Walking, "foot_stiffness", 1200.0),
        (Walking, "foot_weight", None),
        (Walking, "command_timeout", None),
        (Footsteps, "max_forward", 0.15),
        (Footsteps, "min_width", 0.075),
        (PelvisMotion, "max_turn_rate", 0.8),
        (PelvisMotion, "max_acceleration", None),
        (WholeBody, "dcm_gain", 10.0),
        (Disturbance, "edge_margin", 0.015),
        (FallDetection, "tilt", None),
        (HandMotion, "max_speed", 0.125),
    ],
)
def test_defaults_go_by_their_dimension(kind: type[Table], key: str, expected: float | None) -> None:
    assert completed(kind, {}, QUARTER).get(key) == (None if expected is None else pytest.approx(expected))


def test_what_is_said_stays_as_it_is_and_what_is_no_table_too() -> None:
    assert completed(Walking, {"swing_duration": 0.6}, QUARTER)["swing_duration"] == 0.6
    assert completed(Walking, [1], QUARTER) == [1]


def test_a_robots_tables_are_of_its_size(tmp_path: Path) -> None:
    small = robot(
        tmp_path,
        ("leg: 0.82", "leg: 0.205"),
        ("half_width: 0.07425", "half_width: 0.019"),
        ("footsteps: {}", "footsteps: { max_up: 0.1 }"),
    )
    footsteps = small.tables.footsteps
    assert footsteps is not None
    assert (footsteps.max_up, footsteps.max_down, footsteps.min_width) == (
        0.1,
        0.05,
        pytest.approx(0.15 * 0.019 / 0.07425),
    )
    assert small.tables.walking.swing_duration == pytest.approx(0.3)
    assert small.read(Tuning).disturbance.recovery_swing_duration == pytest.approx(0.15)


def test_footsteps_that_are_not_there_stay_so(tmp_path: Path) -> None:
    assert robot(tmp_path, ("footsteps: {}", "")).tables.footsteps is None


def test_what_a_default_does_not_fit_is_told(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"footsteps.min_width: got 0.15; expected less than max_width, 0.12"):
        robot(tmp_path, ("footsteps: {}", "footsteps: { max_width: 0.12 }"))
