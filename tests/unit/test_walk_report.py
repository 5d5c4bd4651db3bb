"""What is told of a walk: numbers that a made-up walk must give, under names that programs read."""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from harness.motion_states import motion_state
from harness.places import ROBOTS
from valor.analysis import track_builder, track_plot
from valor.analysis.track_builder import TrackBuilder
from valor.analysis.walk import Figures, Timeliness, Track
from valor.analysis.walk_report import WalkReport
from valor.common.messages import ClockStatus, MotionState, Proprioceptor
from valor.robot.description import RobotDescription
from valor.robot.legs import knees

ROBOT = RobotDescription.load(ROBOTS / "escher")
COUNT = 400  # control periods
SPEED = 0.3  # [m/s]
BENT, STRAIGHT = 0.9, 0.4  # knees' angles: nearly always, and once [rad]
PLANNED, FELT = 400.0, 390.0  # vertical force under each foot [N]
LATE = 5  # ticks beyond the control period


def walk() -> tuple[list[MotionState], list[Proprioceptor]]:
    """A robot that walks straight on; each state plans the force that is felt a period later."""
    states, measured = [], []
    for k in range(COUNT):
        time = round(1e9 * k * ROBOT.control_period)
        joints = np.zeros(len(ROBOT.joints))
        joints[knees(ROBOT).places] = BENT
        if k == COUNT // 2:
            joints[knees(ROBOT).places[1]] = STRAIGHT
        wrench = np.array([0.0, 0.0, FELT, 0.0, 0.0, 0.0])
        states.append(
            motion_state(
                position=(1e-9 * time * SPEED, 0.0), time=time, proprioceptor_sequence=1000 + k,
                dcm_in_odom=np.array([0.003, 0.0, 0.0]), dcm_reference_in_odom=np.array([0.0, 0.004, 0.0]),
                pelvis_linear_velocity_in_odom=np.array([SPEED, 0.0, 0.0]),
                desired_foot_forces=np.array([PLANNED, PLANNED]), qp_failures=3 + (k > 100),
                torque_saturations=10 + k // 100,
                tick_time=ROBOT.control_period * (1.5 if k < LATE else 0.5),
            )
        )  # fmt: skip
        content: dict[str, Any] = dict.fromkeys(Proprioceptor.__struct_fields__, np.zeros(6))
        content |= {
            "time": time, "sequence": 1000 + k, "motor_sequence": k, "joint_position": joints,
            "left_foot_wrench": wrench, "right_foot_wrench": wrench, "battery_voltage": 48.0, "motor_behavior": "walk",
        }  # fmt: skip
        measured.append(Proprioceptor(**content))
    return states, measured


def clocks() -> list[ClockStatus]:
    return [ClockStatus("lockstep", 0, 1.0, slip, waits, False) for slip, waits in ((2.0, 1), (2.1, 1), (2.5, 3))]


@pytest.fixture(scope="module")
def report() -> WalkReport:
    track = Track.heard(*walk(), ROBOT)
    return WalkReport(Figures.of(track), Timeliness.heard(clocks(), track, ROBOT))


def test_every_figure_is_there_with_its_unit(report: WalkReport) -> None:
    told = json.loads(json.dumps(report.named(), allow_nan=False))
    assert told.pop("tick_p99_s") == pytest.approx(1.5 * ROBOT.control_period)
    assert told == {
        "dcm_error_rms_m": pytest.approx({"x": 0.003, "y": 0.004, "z": 0.0}),
        "smallest_knee_angle_rad": STRAIGHT,
        "torque_saturations": (COUNT - 1) // 100,
        "foot_force_error_rms_n": pytest.approx(PLANNED - FELT),
        "foot_force_error_median_n": pytest.approx(PLANNED - FELT),
        "solver_failures": 1,
        "ticks": COUNT,
        "tick_median_s": pytest.approx(0.5 * ROBOT.control_period),
        "deadlines_missed": LATE,
        "waits_timed_out": 2,
        "clock_slip_s": pytest.approx(0.5),
    }


def test_people_read_the_same(report: WalkReport) -> None:
    rows = dict(report.rows())
    assert rows["smallest knee angle"] == "0.40 rad"
    assert rows["DCM error, rms"].startswith("3.0, 4.0, 0.0 mm")
    assert rows["deadlines missed"] == f"{LATE} of {COUNT}"
    assert rows["solver failures"] == "1"
    assert rows["clock slip"] == "0.50 s"


def test_a_track_made_on_the_way_is_that_of_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """However the messages come in: measurements may be up to ``_LATE`` states behind."""
    monkeypatch.setattr(track_builder, "_PIECE", 50)
    monkeypatch.setattr(track_builder, "_LATE", 20)
    states, measured = walk()
    whole = Track.heard(states, measured, ROBOT)
    builder, chance = TrackBuilder(ROBOT), random.Random(1)
    told = heard = 0
    while told < COUNT:
        now = min(COUNT, told + chance.randrange(12))
        behind = max(heard, now - chance.randrange(15))
        builder.add(states[told:now], measured[heard:behind])
        told, heard = now, behind
    builder.add([], measured[heard:])
    made = builder.track()
    assert made is not None
    assert made.sequence.tolist() == whole.sequence.tolist()
    np.testing.assert_array_equal(made.knee, whole.knee)
    np.testing.assert_array_equal(made.measured_force, whole.measured_force)


def test_states_without_their_measurement_make_no_track() -> None:
    builder = TrackBuilder(ROBOT)
    builder.add(walk()[0], [])
    assert builder.track() is None


def test_a_walk_is_drawn(tmp_path: Path) -> None:
    states, measured = walk()
    file = track_plot.draw(Track.heard(states, measured, ROBOT), tmp_path / "walk.png", "0.24 m in 0.8 s")
    assert file.read_bytes().startswith(b"\x89PNG")
