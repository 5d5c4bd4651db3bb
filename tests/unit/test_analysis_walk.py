"""A walk from a bag: the same as from what an observer received, its beginning and end, and where the feet stood."""

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from harness.analysis_bag import write_messages
from harness.motion_states import motion_state
from harness.places import ROBOTS
from valor.analysis.reading.bag import Bag
from valor.analysis.reading.recording import Recording
from valor.analysis.walk.track import MOVING, SHORTEST_PRINT, Timeliness, Track, WalkMetrics, footprints, named, rows
from valor.bags.errors import BagError
from valor.common.arrays import FloatArray
from valor.common.behaviors import WALKING
from valor.common.messages import ClockStatus, GroundTruth, MotionState, Proprioceptor
from valor.common.topics import CLOCK, GROUND_TRUTH, MOTION_STATE, PROPRIOCEPTOR
from valor.robot.description import RobotDescription
from valor.robot.legs import knees
from valor.robot.model import full_model

PERIOD = 0.01  # of the truth [s]


def altered(state: MotionState, **changes: object) -> MotionState:
    content = {name: getattr(state, name) for name in MotionState.__struct_fields__}
    return MotionState(**(content | changes))


def recording(path: Path, *messages: object) -> Recording:
    topics = {topic.type: topic for topic in (MOTION_STATE, PROPRIOCEPTOR, GROUND_TRUTH, CLOCK)}
    write_messages(path, [(topics[type(message)], message) for message in messages])  # type: ignore[index, misc]
    return Recording(Bag(path), ROBOT)


def test_a_bag_gives_what_an_observer_received(tmp_path: Path) -> None:
    states, measured = walk()
    received = Track.from_messages(states, measured, ROBOT)
    reported = Track.of(recording(tmp_path / "walk.mcap", *states, *measured))
    for field in fields(Track):
        np.testing.assert_allclose(getattr(reported, field.name), getattr(received, field.name), err_msg=field.name)
    assert WalkMetrics.of(reported) == WalkMetrics.of(received)


def test_a_state_whose_measurement_no_one_received_is_left_out_and_no_force_is_compared_across_it() -> None:
    states, measured = walk()
    whole = Track.from_messages(states, measured, ROBOT)
    wild = altered(states[9], desired_foot_forces=np.full(2, 1e6))  # nobody receives what was felt a period later
    part = Track.from_messages([*states[:9], wild, *states[10:]], measured[:10] + measured[11:], ROBOT)
    assert part.sequence.tolist() == [*whole.sequence[:10], *whole.sequence[11:]]
    figures = WalkMetrics.of(part)
    assert figures.force_error == pytest.approx(WalkMetrics.of(whole).force_error) and figures.ticks == COUNT - 1


def walked(behaviors: list[str], speeds: list[float]) -> Track:
    states, measured = walk()
    made = [altered(state, behavior=behavior, pelvis_linear_velocity_in_odom=np.array([0.0, speed, 0.0]))
            for state, behavior, speed in zip(states, behaviors, speeds, strict=False)]  # fmt: skip
    return Track.from_messages(made, measured, ROBOT)


@pytest.mark.parametrize("behavior", sorted(WALKING))
def test_a_walk_lasts_from_the_first_motion_to_the_last(behavior: str) -> None:
    slow, fast = 0.9 * MOVING, 1.1 * MOVING
    track = walked(["stand"] * 3 + [behavior] * 9 + ["stand"] * 3,
                   [fast] * 3 + [slow] * 2 + [fast, slow, fast, fast] + [slow] * 3 + [fast] * 3)  # fmt: skip
    assert track.walk() == (track.time[5], track.time[8])
    part = track.between(*track.walk())
    assert part.sequence.tolist() == track.sequence[5:9].tolist()
    pieces = [track.between(track.time[a], track.time[b]) for a, b in ((0, 5), (6, 14))]
    assert Track.joined(pieces).sequence.tolist() == track.sequence.tolist()


def test_a_walk_ends_with_the_fall_and_not_where_the_robot_comes_to_rest() -> None:
    track = walked(["fall", "walk", "walk", "walk", "fall", "fall", "walk"], [1.0] * 7)
    assert track.walk() == (track.time[1], track.time[4]) and WalkMetrics.of(track.between(*track.walk())).fell
    assert not WalkMetrics.of(track.between(track.time[1], track.time[3])).fell


@pytest.mark.parametrize(("behavior", "speed"), [("stand", 1.0), ("walk", 0.0)])
def test_who_never_walked_or_never_moved_has_no_walk(behavior: str, speed: float) -> None:
    with pytest.raises(BagError, match="never walked"):
        walked([behavior] * 5, [speed] * 5).walk()


def test_what_is_counted_since_start_is_counted_for_the_walk_alone() -> None:
    states, measured = walk()
    states[0] = altered(states[0], qp_failures=3, torque_saturations=40)
    states[-1] = altered(states[-1], qp_failures=20, torque_saturations=95)
    figures = WalkMetrics.of(Track.from_messages(states, measured, ROBOT))
    assert (figures.qp_failures, figures.saturations) == (17, 55)


def test_time_that_was_lost_is_counted_while_the_walk_lasted(tmp_path: Path) -> None:
    states, measured = walk()
    clocks = [ClockStatus("lockstep", round(1e9 * k * 0.1), 1.0, 0.5 * k, k * k, False) for k in range(9)]
    bag = recording(tmp_path / "clock.mcap", *states, *measured, *clocks)
    track = Track.of(bag).between(0.2, 0.5)
    assert Timeliness.of(bag, track) == Timeliness(0, 25 - 4, pytest.approx(1.5))  # type: ignore[arg-type]
    assert Timeliness.of(bag, Track.of(bag)).deadlines_missed == LATE
    silent = recording(tmp_path / "no_clock.mcap", *states, *measured)
    assert Timeliness.of(silent, track) == Timeliness(0, 0, 0.0)


def truth(k: int, pose: tuple[FloatArray, FloatArray], left: bool, right: bool) -> GroundTruth:
    zeros = np.zeros(3)
    return GroundTruth(
        time=round(1e9 * k * PERIOD), pelvis_position_in_world=pose[0], pelvis_orientation_in_world=pose[1],
        pelvis_linear_velocity_in_world=zeros, com_in_world=zeros, contacts=np.array([left, right], dtype=np.uint8),
        joint_position=ROBOT.nominal_posture, fixture_position=np.zeros(0),
    )  # fmt: skip


def pose(k: int) -> tuple[FloatArray, FloatArray]:
    """Of a pelvis that goes on and turns."""
    turn = 0.02 * k
    return np.array([0.01 * k, 0.3, 0.9]), np.array([np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2)])


def test_a_foot_is_printed_where_it_stood_in_the_middle_of_its_stand(tmp_path: Path) -> None:
    shortest = round(SHORTEST_PRINT / PERIOD) + 1
    left = [True] * 20 + [False] * 10 + [True] * (shortest - 1) + [False] * 5 + [True] * (shortest + 1)
    right = [10 <= k < 40 for k in range(len(left))]
    bag = recording(
        tmp_path / "feet.mcap", *(truth(k, pose(k), *each) for k, each in enumerate(zip(left, right, strict=True)))
    )
    begins = len(left) - shortest - 1
    middles = [(True, 19 // 2), (False, (10 + 39) // 2), (True, (begins + len(left) - 1) // 2)]
    found = footprints(bag)
    assert [(each.left, round(each.time / PERIOD)) for each in found] == middles
    model = full_model(ROBOT)
    data = mujoco.MjData(model.mj)
    for each, (is_left, k) in zip(found, middles, strict=True):
        data.qpos[:3], data.qpos[3:7] = pose(k)
        data.qpos[model.qpos] = ROBOT.nominal_posture[model.joint_indices]
        mujoco.mj_forward(model.mj, data)
        sole = data.site((ROBOT.tables.feet.left if is_left else ROBOT.tables.feet.right).sole)
        np.testing.assert_allclose(each.position, sole.xpos, atol=1e-9)
        assert each.heading == pytest.approx(0.02 * k, abs=1e-6)
    hanging = recording(tmp_path / "air.mcap", *(truth(k, pose(k), False, False) for k in range(3)))
    with pytest.raises(BagError, match="no foot in contact"):
        footprints(hanging)


# What is reported of a walk: numbers that a made-up walk must give, under names that programs read.
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
        joints[knees(ROBOT).indices] = BENT
        if k == COUNT // 2:
            joints[knees(ROBOT).indices[1]] = STRAIGHT
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


@pytest.fixture(scope="module")
def report() -> tuple[WalkMetrics, Timeliness]:
    return WalkMetrics.of(Track.from_messages(*walk(), ROBOT)), Timeliness(LATE, 2, 0.5)


def test_every_figure_is_there_with_its_unit(report: tuple[WalkMetrics, Timeliness]) -> None:
    reported = json.loads(json.dumps(named(*report), allow_nan=False))
    assert reported.pop("tick_p99_s") == pytest.approx(1.5 * ROBOT.control_period)
    assert reported == {
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


def test_the_table_shows_the_same(report: tuple[WalkMetrics, Timeliness]) -> None:
    shown = dict(rows(*report))
    assert shown["smallest knee angle"] == "0.40 rad" and shown["DCM error, rms"].startswith("3.0, 4.0, 0.0 mm")
    assert shown["deadlines missed"] == f"{LATE} of {COUNT}" and shown["solver failures"] == "1"
    assert shown["clock slip"] == "0.50 s"
