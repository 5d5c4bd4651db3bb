"""The last seconds, saved when asked and on a fall."""

import time
from datetime import datetime
from pathlib import Path

import numpy as np
from mcap.exceptions import McapError
from rclpy.node import Node
from std_msgs.msg import String

from harness.instance import RunningInstance
from harness.motion_states import motion_state
from harness.waiting import wait_until
from tests.integration.bag_recorder.recorder import KEPT, MOTORS, Stream, bags, counts, metadata, newest, recorder
from valor.bag_recorder.recording import AFTER_FALL
from valor.bags import recordings, rosbag2_metadata
from valor.bags.recovery import recover
from valor.common.instance import Recording
from valor.common.messages import MarkRequest, SnapRequest
from valor.common.topics import MARK, MOTION_STATE, MOTOR, SNAP
from valor.valorctl.recordings import bag_summary


def metadata_of_finished(path: Path) -> bool:
    try:
        return bool(metadata(path, "topics"))
    except McapError:
        return False


def test_the_last_seconds_are_saved_when_asked_and_on_a_fall(instance: RunningInstance, ros: Node) -> None:
    description = ros.create_publisher(String, "/robot_description", KEPT)
    description.publish(String(data="<robot/>"))
    instance.configure(recording=Recording(ring_seconds=2.0))
    instance.start("bag_recorder")
    instance.wait_ready("bag_recorder")
    assert bags(instance) == []
    wait_until(lambda: description.get_subscription_count() == 1, 20.0, "the recorder hears what is latched")
    node = instance.node()
    client = SNAP.client(node)
    stream = Stream(MOTOR.publisher(node), 100.0)
    stream.start()
    states = MOTION_STATE.publisher(node)
    wait_until(lambda: len(stream.sent) > 300, 30.0, "more than fits in two seconds")

    reply = client.call(SnapRequest(), timeout=20.0)
    assert reply.accepted, reply.reason
    saved = Path(reply.path)
    assert bags(instance) == [saved] and saved.stem.endswith("_snap") and recover(saved).finished
    found = counts(saved)
    assert found["/robot_description"] == 1 and sum(found.values()) == reply.messages
    assert 0 < found[MOTORS] < len(stream.sent) - 50 and newest(saved, MOTORS) > 250

    def fallen() -> list[Path]:
        states.publish(motion_state(behavior="fall", contacts=np.zeros(2, np.uint8)))
        return [each for each in bags(instance) if "_fall" in each.stem]

    began = time.monotonic()
    (fall,) = wait_until(fallen, 30.0, "the fall is saved", 0.05)
    assert time.monotonic() - began >= AFTER_FALL
    wait_until(lambda: metadata_of_finished(fall), 20.0, "all of it", 0.1)
    assert counts(fall)["/bifrost/" + MOTION_STATE.name] > 1
    head = wait_until(lambda: rosbag2_metadata.head(fall.parent), 20.0, "rosbag2 knows")
    ((when, what),) = head.events.items()
    assert what.startswith("fall: ")
    fell = datetime.fromisoformat(when).timestamp()
    assert recordings.holding(instance.instance.folder, fell + 0.5) == fall  # two seconds are held, two follow a fall
    (row,) = (row for row in bag_summary.rows(instance.instance) if row.name == fall.parent.name)
    assert (row.size, row.written, row.instance) == (fall.stat().st_size, False, "test")
    assert len(row.events) == 1 and row.events[0].endswith(what)
    for _ in range(20):
        fallen()
    assert len(bags(instance)) == 2, "a fall is saved once"
    assert MARK.client(node).call(MarkRequest(" the hand\n slips "), timeout=20.0).accepted
    marked = Path(client.call(SnapRequest(), timeout=20.0).path)
    assert ("mark", "the hand slips") in events(marked)
    stream.stop()
    assert instance.stop("bag_recorder") == 0 and len(bags(instance)) == 3


def events(bag: Path) -> list[tuple[str, str]]:
    return [(each["what"], each["reason"]) for each in metadata(bag, "event")]


def test_a_recorder_of_everything_marks_moments_and_has_nothing_to_snap(instance: RunningInstance) -> None:
    recorder(instance)
    snapped = SNAP.client(instance.node()).call(SnapRequest(), timeout=20.0)
    assert not snapped.accepted and "everything is being recorded" in snapped.reason
    client = MARK.client(instance.node())
    before = time.time_ns()
    marked = client.call(MarkRequest("here it slips"), timeout=20.0)
    assert marked.accepted and before <= marked.stamp <= time.time_ns()
    for text in ("", " \n", "x" * 201):
        refused = client.call(MarkRequest(text), timeout=20.0)
        assert not refused.accepted and "expected 1 to 200" in refused.reason
    assert instance.stop("bag_recorder") == 0
    (bag,) = bags(instance)
    assert events(bag) == [("mark", "here it slips")]
    head = rosbag2_metadata.head(bag.parent)
    assert head is not None and list(head.events.values()) == ["mark: here it slips"]
