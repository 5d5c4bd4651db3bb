"""Bags are read as they were written; what is wrong with one is said, file and topic named."""

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer as McapWriter

from bifrost import Message
from harness import analysis_bag
from harness.examples import examples
from harness.places import REPOSITORY, ROBOTS
from thesis.analysis.signals import Signal, common_rate
from thesis.errors import SignalError
from valor.analysis.reading.bag import Bag
from valor.analysis.reading.recording import Recording
from valor.analysis.robot import before_after, tracking_plots
from valor.bags.errors import BagError
from valor.bags.stored import StoredBag
from valor.common.messages import GroundTruth, JointSetpoints, MotionState, Motor, Proprioceptor
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

    setpoints, sent = recording.setpoints(), [each for _, each in written if isinstance(each, JointSetpoints)]
    assert set(setpoints) == set(sent[0].names)
    for i, joint in enumerate(sent[0].names):
        np.testing.assert_array_equal(setpoints[joint][1], [message.position[i] for message in sent])

    states = recording.series(MOTION_STATE)
    expected = [message.behavior for _, message in written if isinstance(message, MotionState)]
    assert states.strings("behavior").tolist() == expected
    assert recording.manipulation() == pytest.approx((analysis_bag.STAND, analysis_bag.FREE), abs=0.02)


def test_the_posture_has_the_positions_of_fixtures(tmp_path: Path) -> None:
    def messages() -> Iterator[tuple[Topic[Any], Message]]:
        for topic, message in analysis_bag.simulate(ROBOT):
            if isinstance(message, GroundTruth):
                message.fixture_position = np.array([0.7, 0.2]) * min(1.0, 1e-9 * message.time / 2.0)
            yield topic, message

    analysis_bag.write_messages(tmp_path / "door.mcap", messages())
    recording = Recording(Bag(tmp_path / "door.mcap"), ROBOT)
    for seconds in (0.5, 1.5, 3.0):
        expected = np.array([0.7, 0.2]) * min(1.0, seconds / 2.0)
        np.testing.assert_allclose(recording.posture(seconds).fixture_position, expected, atol=0.01)


def test_nested_fields_and_wrong_ones(file: Path) -> None:
    series = Bag(file)["/bifrost/motion_manager/motor"]
    assert series.type == "valor_msgs/msg/Motor"
    assert np.all(np.diff(series["header.stamp.sec"] + 1e-9 * series["header.stamp.nanosec"]) > 0)
    with pytest.raises(BagError, match="/bifrost/motion_manager/motor: valor_msgs/msg/Motor has no field 'positions'"):
        series["positions"]
    with pytest.raises(BagError, match=r"reach\.mcap: no messages on /joint_states; the bag has .*motor"):
        Bag(file)["/joint_states"]


@pytest.mark.parametrize("topic", [PROPRIOCEPTOR, MOTION_STATE, JOINT_SETPOINTS])
def test_figures_name_a_missing_topic(tmp_path: Path, topic: Topic[Any]) -> None:
    path = tmp_path / "poor.mcap"
    analysis_bag.write(path, ROBOT, without=topic)
    if topic is not JOINT_SETPOINTS:
        with pytest.raises(BagError, match=f"no messages on /bifrost/{topic.name};"):
            before_after.render_before_after(path, ROBOT, tmp_path / "out")
    with pytest.raises(BagError, match=f"no messages on /bifrost/{topic.name};"):
        tracking_plots.joint_tracking(path, ROBOT, ["neck"], tmp_path / "out")


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


# Pictures show the robot, and show that it moved; plots show every joint.
@pytest.fixture(scope="module")
def bag(file: Path) -> Bag:
    return Bag(file)


def read(path: Path) -> np.ndarray:
    """(height, width, 3), 0 to 1."""
    return np.asarray(matplotlib.image.imread(path))[:, :, :3]


def panels(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """The two pictures in a file, without the line between them."""
    width, height = before_after.PANEL
    image = read(path)[-height:]
    return image[:, 8 : width - 8], image[:, width + 8 : 2 * width - 8]


def test_before_and_after_differ_where_the_arm_moved(bag: Bag, tmp_path: Path) -> None:
    (path,) = before_after.render_before_after(bag, ROBOT, tmp_path / "out")
    image = read(path)
    width, height = before_after.PANEL
    assert image.shape[1] == 2 * width and image.shape[0] > height
    before, after = panels(path)
    for panel in (before, after):
        assert panel.std() > 0.1  # a robot, not a wall
    moved = np.abs(before - after).max(axis=2) > 0.1
    assert 0.01 < moved.mean() < 0.5  # an arm and a head, not the world
    assert not moved[: height // 12].any()  # the sky


def test_without_opengl_the_error_states_what_to_install(bag: Bag, tmp_path: Path) -> None:
    program = (
        "import sys; from pathlib import Path\n"
        "from valor.analysis.robot import before_after; from valor.drawing import RenderingError\n"
        "from valor.robot.description import RobotDescription\n"
        "robot = RobotDescription.load(Path(sys.argv[2]))\n"
        "try: before_after.render_before_after(Path(sys.argv[1]), robot, Path(sys.argv[3]))\n"
        "except RenderingError as error: print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(bag.path), str(ROBOT.folder), str(tmp_path)],
        env=os.environ | {"MUJOCO_GL": "egl", "PYOPENGL_PLATFORM": "none-such"}, capture_output=True, text=True,
        timeout=120, check=True,
    )  # fmt: skip
    said = done.stdout.partition(";")[0].strip()
    assert said and f"`{said}`" in (REPOSITORY / "README.md").read_text()
    assert done.stdout.count("\n") == 1


def test_joint_tracking_draws_each_group(bag: Bag, tmp_path: Path) -> None:
    paths = tracking_plots.joint_tracking(bag, ROBOT, ["right_arm", "neck"], tmp_path / "deep" / "out")
    assert [path.name for path in paths] == ["joint_tracking_right_arm.png", "joint_tracking_neck.png"]
    arm, neck = (read(path) for path in paths)
    assert arm.shape[1] == neck.shape[1]
    assert arm.shape[0] > neck.shape[0]  # seven joints take more rows than two
    for image in (arm, neck):
        for color in ((0x00, 0x72, 0xB2), (0xD5, 0x5E, 0x00)):  # command and measurement
            assert (np.abs(image - np.array(color) / 255).max(axis=2) < 0.02).sum() > 500
    with pytest.raises(BagError, match=r"no joint group 'third_arm'; it has left_leg, .*neck"):
        tracking_plots.joint_tracking(bag, ROBOT, ["third_arm"], tmp_path)


# Signals at a common rate; metadata of other writers in a bag.
moments = st.lists(st.floats(0.01, 0.5), min_size=4, max_size=30).map(np.cumsum)


@given(moments, moments, st.floats(-3.0, 3.0))
def test_two_signals_meet_where_both_are_known(first: np.ndarray, second: np.ndarray, shift: float) -> None:
    second = second + shift
    begin, end = max(first[0], second[0]), min(first[-1], second[-1])
    try:
        rate, one, two = common_rate(Signal.of(first, 2.0 * first), Signal.of(second, -second))
    except SignalError:
        rate = max((len(each) - 1) / (each[-1] - each[0]) for each in (first, second))
        assert (end - begin) * rate < 8.0
        return
    assert rate == pytest.approx(max((len(each) - 1) / (each[-1] - each[0]) for each in (first, second)))
    met = -two
    np.testing.assert_allclose(one, 2.0 * met, atol=1e-9)
    np.testing.assert_allclose(np.diff(met), 1.0 / rate, atol=1e-9)
    assert met[0] == pytest.approx(begin, abs=1e-9) and end - 1.0 / rate - 1e-9 < met[-1] <= end + 1e-9


def test_what_another_reports_of_itself_is_not_taken_for_the_recorders_word(tmp_path: Path) -> None:
    path = tmp_path / "bag.mcap"
    with open(path, "wb") as file:
        writer = McapWriter(file)
        writer.start("ros2", "somebody")
        writer.add_metadata("valor", {"robot": "escher"})
        writer.add_metadata("another", {"robot": "atlas"})
        writer.add_metadata("zebra", {"robot": "zoe"})
        text = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        writer.add_message(writer.register_channel("/words", "cdr", text), 1, b"\0\1\0\0\2\0\0\0a\0", 1)
        writer.finish()
    stored = StoredBag(path)
    assert len(list(stored.messages())) == 1 and stored.condition.origin == {"robot": "escher"}
