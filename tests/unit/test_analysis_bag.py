"""Bags are read as they were written; what is wrong with one is said, file and topic named."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness import analysis_bag
from harness.examples import examples
from harness.places import ROBOTS
from valor.analysis import pictures, plots
from valor.analysis.bag import Bag
from valor.analysis.recording import Recording, nearest
from valor.bags.errors import BagError
from valor.common.messages import JointSetpoints, MotionState, Motor, Proprioceptor
from valor.common.topics import JOINT_SETPOINTS, MOTION_STATE, MOTOR, PROPRIOCEPTOR, Topic
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(ROBOTS / "escher")


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bag") / "reach.mcap"
    analysis_bag.write(path, ROBOT)
    return path


def test_every_message_comes_back_as_it_was_written(file: Path) -> None:
    written = list(analysis_bag.simulate(ROBOT))
    recording = Recording(Bag(file), ROBOT)
    recording.load(PROPRIOCEPTOR, MOTOR, MOTION_STATE)

    senses = [message for _, message in written if isinstance(message, Proprioceptor)]
    times, measured = recording.measured()
    np.testing.assert_allclose(times, [message.time * 1e-9 for message in senses], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(measured, [message.joint_position for message in senses])

    commands = [message.position for _, message in written if isinstance(message, Motor)]
    np.testing.assert_array_equal(recording.commands()[1], commands)

    states = recording.series(MOTION_STATE)
    expected = [message.behavior for _, message in written if isinstance(message, MotionState)]
    assert states.strings("behavior").tolist() == expected
    assert recording.manipulation() == pytest.approx((analysis_bag.STAND, analysis_bag.FREE), abs=0.02)


def test_set_points_come_back_by_joint(file: Path) -> None:
    setpoints = Recording(Bag(file), ROBOT).setpoints()
    written = [message for _, message in analysis_bag.simulate(ROBOT) if isinstance(message, JointSetpoints)]
    assert set(setpoints) == set(written[0].names)
    for i, joint in enumerate(written[0].names):
        np.testing.assert_array_equal(setpoints[joint][1], [message.position[i] for message in written])


def test_nested_fields_and_wrong_ones(file: Path) -> None:
    series = Bag(file)["/bifrost/motion_manager/motor"]
    assert series.type == "valor_msgs/msg/Motor"
    assert np.all(np.diff(series["header.stamp.sec"] + 1e-9 * series["header.stamp.nanosec"]) > 0)
    with pytest.raises(BagError, match="/bifrost/motion_manager/motor: valor_msgs/msg/Motor has no field 'positions'"):
        series["positions"]


def test_a_missing_topic_is_named_with_those_that_are_there(file: Path) -> None:
    with pytest.raises(BagError, match=r"reach\.mcap: no messages on /joint_states; the bag has .*motor"):
        Bag(file)["/joint_states"]


@pytest.mark.parametrize("topic", [PROPRIOCEPTOR, MOTION_STATE])
def test_pictures_name_the_topic_that_they_miss(tmp_path: Path, topic: Topic[Any]) -> None:
    path = tmp_path / "poor.mcap"
    analysis_bag.write(path, ROBOT, without=topic)
    with pytest.raises(BagError, match=f"no messages on /bifrost/{topic.name};"):
        pictures.render_before_after(path, ROBOT, tmp_path / "out")
    with pytest.raises(BagError, match=f"no messages on /bifrost/{topic.name};"):
        plots.joint_tracking(path, ROBOT, ["neck"], tmp_path / "out")


def test_plots_name_the_set_points_that_they_miss(tmp_path: Path) -> None:
    path = tmp_path / "poor.mcap"
    analysis_bag.write(path, ROBOT, without=JOINT_SETPOINTS)
    with pytest.raises(BagError, match="no messages on /bifrost/motion_manager/joint_setpoints;"):
        plots.joint_tracking(path, ROBOT, ["neck"], tmp_path / "out")


def test_no_file_and_no_bag(tmp_path: Path) -> None:
    with pytest.raises(BagError, match=r"none\.mcap: No such file or directory"):
        Bag(tmp_path / "none.mcap")
    text = tmp_path / "text.mcap"
    text.write_text("not a bag")
    with pytest.raises(BagError, match=r"text\.mcap: neither MCAP nor SQLite"):
        Bag(text)


def test_a_bag_cut_off_is_read_to_where_it_was_written(file: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(file.read_bytes()[: file.stat().st_size * 2 // 3])
    whole, part = Bag(file), Bag(cut)
    expected, got = whole["/bifrost/motion_manager/motor"], part["/bifrost/motion_manager/motor"]
    assert part.truncated and not whole.truncated
    assert 0 < len(got) < len(expected)
    np.testing.assert_array_equal(got["position"], expected["position"][: len(got)])


@given(st.floats(0.0, 0.99), st.binary(min_size=64, max_size=4096))
@examples(25)
def test_garbage_in_a_bag_is_an_error_of_the_bag_and_of_nothing_else(file: Path, where: float, garbage: bytes) -> None:
    broken = file.with_name("broken.mcap")
    content = bytearray(file.read_bytes())
    at = int(where * len(content))
    content[at : at + len(garbage)] = garbage
    broken.write_bytes(content)
    with contextlib.suppress(BagError):  # anything else fails the test; undamaged topics may still be read
        Bag(broken)["/bifrost/motion_manager/motor"]["position"]


def test_a_damaged_chunk_is_named(file: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken.mcap"
    content = bytearray(file.read_bytes())
    content[len(content) // 2 : len(content) // 2 + 4096] = b"\xff" * 4096
    broken.write_bytes(content)
    with pytest.raises(BagError, match=r"damaged: .*broken\.mcap: "):
        Bag(broken)["/bifrost/motion_manager/motor"]


def test_another_robots_bag_is_refused(file: Path) -> None:
    tables = ROBOT.tables
    joints = {name: joint for name, joint in tables.joints.items() if name != "lidar_roll"}
    groups = {name: members for name, members in tables.groups.items() if "lidar_roll" not in members}
    thor = msgspec.structs.replace(tables, name="thor", joints=joints, groups=groups, devices={})
    other = RobotDescription(ROBOT.folder, thor)
    with pytest.raises(BagError, match=r"38 joints in 'joint_position'; robot 'thor' has 37"):
        Recording(Bag(file), other).measured()


def test_nearest_agrees_with_a_search_by_hand() -> None:
    generator = np.random.default_rng(0)
    for n in (1, 2, 3, 17):
        times = np.sort(generator.uniform(0.0, 10.0, n))
        wanted = generator.uniform(-1.0, 11.0, 50)
        expected = np.abs(times[None, :] - wanted[:, None]).argmin(axis=1)
        np.testing.assert_array_equal(nearest(times, wanted), expected)
