"""The files of recordings: their names, their pieces, and which of them are kept."""

import json
import os
import re
import shutil
import time
from pathlib import Path

import numpy as np
import pytest
from rclpy.node import Node
from rosbags.highlevel import AnyReader
from std_msgs.msg import String

from harness.instance import RunningInstance
from harness.waiting import wait_until
from tests.integration.bag_recorder import recorder as kit
from tests.integration.bag_recorder.recorder import KEPT, MOTORS, Stream, bags, counts, has, metadata, read, recorder
from valor.bag_recorder.bag import Bag, RecordedTopic
from valor.bags import recordings
from valor.bags.recovery import recover
from valor.common.instance import Bounds, Recording
from valor.common.processes import EXIT_CONFIGURATION
from valor.common.topics import MOTOR
from valor.ros.definitions import definition
from valor.valorctl.recordings import recording_report

OLD = "2026-01-02_10-00-00"


@pytest.mark.parametrize(
    ("bag", "reported"),
    [
        ("/dev/null/a.mcap", "/dev/null"),
        ("/tmp/a.bag", "bag: /tmp/a.bag: expected a folder or a name that ends in .mcap"),
    ],
)
def test_a_bag_that_cannot_be_written_is_one_clear_line(instance: RunningInstance, bag: str, reported: str) -> None:
    instance.configure(bag=Path(bag))
    process = instance.start("bag_recorder")
    assert process.wait(30) == EXIT_CONFIGURATION
    (line,) = instance.log("bag_recorder").splitlines()
    assert "ERROR bag_recorder" in line and reported in line


def test_a_bag_that_exists_is_kept(instance: RunningInstance) -> None:
    wanted = instance.instance.bags / "run.mcap"
    wanted.write_bytes(b"precious")
    instance.configure(bag=wanted)
    path = recorder(instance)
    assert path.name == "run_1.mcap"
    assert instance.stop("bag_recorder") == 0
    assert wanted.read_bytes() == b"precious"
    assert recover(path).finished


def test_a_named_folder_is_one_bag_whatever_happens_to_its_recorder(instance: RunningInstance) -> None:
    folder = instance.instance.bags / "walk"
    instance.configure(bag=folder)
    first = recorder(instance)
    wait_until(lambda: has(first, "/bifrost/bag_recorder/statistics", 1), 20.0, "something is in the bag", 0.3)
    instance.kill("bag_recorder")
    second = recorder(instance)
    wait_until(lambda: has(second, "/bifrost/bag_recorder/statistics", 1), 20.0, "something is in the bag", 0.3)
    assert instance.stop("bag_recorder") == 0
    assert [first, second] == [folder / "walk.mcap", folder / "walk_1.mcap"]
    with AnyReader([folder]) as reader:
        counted = sum(recover(path).messages for path in (first, second))
        assert reader.message_count == counted and len([1 for _ in reader.messages()]) == counted


def test_bags_split_by_size_hold_all_and_each_what_is_latched(instance: RunningInstance, ros: Node) -> None:
    description = ros.create_publisher(String, "/robot_description", KEPT)
    description.publish(String(data="<robot/>"))
    instance.configure(recording=Recording(split_bytes=1 << 20))
    path = recorder(instance)
    wait_until(lambda: has(path, "/robot_description", 1), 20.0, "what is latched is in the first bag", 0.2)
    node = instance.node()
    stream = Stream(MOTOR.publisher(node), 800.0)
    stream.start()
    wait_until(lambda: len(bags(instance)) >= 3, 60.0, "two bags are full", 0.1)
    stream.stop()
    assert instance.stop("bag_recorder") == 0
    made = bags(instance)
    assert made[0] == path and all(recover(each).finished for each in made)
    assert [counts(each)["/robot_description"] for each in made] == [1] * len(made)
    kept = [sequence for each in made for sequence in kit.sequences(each, MOTORS)]
    assert kept == list(range(kept[0], stream.sent[-1] + 1))
    reported = [json.loads(metadata(each, "topics")[0][MOTORS]) for each in made]
    assert [each["received"] for each in reported] == [each["written"] for each in reported]
    with AnyReader(made) as reader:  # the row reads as one bag
        assert reader.message_count == sum(sum(counts(each).values()) for each in made)


def a_recording(folder: Path, name: str, size: int) -> Path:
    path = folder / name / f"{name}.mcap"
    path.parent.mkdir()
    bag = Bag(path)
    chatter = RecordedTopic("/chatter", "std_msgs/msg/String", definition("std_msgs/msg/String"))
    bag.write(chatter, 0, 0, 0, np.random.default_rng(0).bytes(size))
    bag.close()
    os.utime(path, (recordings.begun(name),) * 2)
    return path


def test_a_recorder_keeps_all_recordings_within_bounds_its_own_pieces_too(instance: RunningInstance) -> None:
    folder = instance.instance.bags
    kept, old = (a_recording(folder, name, size) for name, size in (("2026-01-01_10-00-00", 6 << 20), (OLD, 1 << 20)))
    recordings.keep(recordings.look(folder)[0], True)
    (folder / "walk").mkdir()
    foreign = folder / "walk" / "walk.mcap"
    shutil.copyfile(kept, foreign)
    bounds = Bounds(age=None, size=9 << 20, share=None)
    instance.configure(recording=Recording(bounds=bounds, only=(MOTORS,)))
    path = recorder(instance)
    node = instance.node()
    stream = Stream(MOTOR.publisher(node), 1000.0)
    stream.start()
    wait_until(lambda: not path.exists(), 60.0, "its own first piece has gone", 0.1)
    glance = recording_report.glance(instance.instance, bounds)
    assert glance.path is not None and glance.path.parent == path.parent and 0 < glance.size < glance.total
    assert recordings.holding(instance.instance.folder, time.time() - 0.01) is not None
    stream.stop()
    assert instance.stop("bag_recorder") == 0

    assert kept.exists() and foreign.exists() and not old.parent.exists()
    made = sorted(path.parent.glob("*.mcap"), key=lambda each: each.stat().st_mtime)
    assert made and sum(each.size for each in recordings.look(folder)) <= (bounds.size or 0) + (2 << 20)
    found = [message.sequence for each in made for _, message in read(each)]
    assert found == list(range(found[0], stream.sent[-1] + 1)), "all that was written since"
    with AnyReader([path.parent]) as reader:
        assert reader.message_count == len(found)
    assert instance.log("bag_recorder").count(": removed, ") == 1 + int(re.findall(r"_(\d+)$", made[0].stem)[0])
