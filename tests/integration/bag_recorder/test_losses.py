"""A recorder that is killed, or stands, or has no room on its disk."""

import json
import resource
import time

import psutil
import pytest

from harness.instance import RunningInstance
from harness.waiting import wait_until
from tests.integration.bag_recorder import recorder as kit
from tests.integration.bag_recorder.recorder import MOTORS, Stream, bags, counts, has, metadata, motor, newest, recorder
from valor.bag_recorder.bifrost_tap import QUEUE
from valor.bags.recovery import recover
from valor.common.messages import Statistics
from valor.common.topics import MOTOR, STATISTICS


def test_a_killed_recorder_leaves_a_bag_that_the_next_one_finishes(instance: RunningInstance) -> None:
    first = recorder(instance)
    node = instance.node()
    stream = Stream(MOTOR.publisher(node), 200.0)
    stream.start()
    wait_until(lambda: has(first, MOTORS, 400), 30.0, "two seconds are in the bag", 0.3)
    said = stream.sent[-1]
    wait_until(lambda: newest(first, MOTORS) >= said, 30.0, "so is all that was said by then", 0.3)
    instance.kill("bag_recorder")

    second = recorder(instance)
    assert second != first
    assert recover(first).finished, "finished by the one that came after"
    kept = kit.sequences(first, MOTORS)
    assert kept == list(range(kept[0], kept[-1] + 1)) and kept[-1] >= said

    wait_until(lambda: has(second, MOTORS, 100), 30.0, "the new bag goes on", 0.3)
    stream.stop()
    assert instance.stop("bag_recorder") == 0
    assert recover(second).finished
    (gap,) = metadata(second, "event")
    last = max(message.log_time for _, message in kit.read(first))
    begun = min(message.log_time for _, message in kit.read(second))
    assert (gap["what"], int(gap["stamp_ns"])) == ("gap", last)
    assert float(gap["reason"].split()[-2]) == pytest.approx((begun - last) * 1e-9, abs=5.0)


def test_a_full_disk_costs_no_more_than_what_does_not_fit(instance: RunningInstance) -> None:
    """Full when the recorder starts, then with room, then full again, and with room again."""
    node = instance.node()
    statistics = STATISTICS["bag_recorder"].subscriber(node, queue=100)

    def received(state: str) -> Statistics | None:
        said = [each.message for each in statistics.drain() if each.message.state == state]
        return said[-1] if said else None

    process = psutil.Process(instance.start("bag_recorder").pid)
    _, hard = process.rlimit(psutil.RLIMIT_FSIZE)
    process.rlimit(psutil.RLIMIT_FSIZE, (700, hard))  # less than a bag reports of itself first
    reported = wait_until(lambda: received("degraded"), 40.0, "the recorder runs, and says that it does not record")
    assert "not recording: " in reported.detail and "File too large" in reported.detail
    assert process.is_running() and bags(instance) == []
    process.rlimit(psutil.RLIMIT_FSIZE, (resource.RLIM_INFINITY, hard))
    wait_until(lambda: received("ready"), 30.0, "the recorder records")
    (path,) = bags(instance)
    stream = Stream(MOTOR.publisher(node), 200.0)
    stream.start()
    wait_until(lambda: has(path, MOTORS, 100), 30.0, "the bag has begun", 0.3)

    process.rlimit(psutil.RLIMIT_FSIZE, (path.stat().st_size + (64 << 10), hard))
    reported = wait_until(lambda: received("degraded"), 20.0, "the recorder says that it does not record")
    assert "not recording: " in reported.detail and path.name in reported.detail and "File too large" in reported.detail
    assert recover(path).finished
    kept = counts(path)[MOTORS]
    assert kept >= 100

    process.rlimit(psutil.RLIMIT_FSIZE, (resource.RLIM_INFINITY, hard))
    wait_until(lambda: received("ready"), 30.0, "the recorder records again")
    stream.stop()
    assert instance.process("bag_recorder").poll() is None
    assert instance.log("bag_recorder").count("not recording") == 1
    assert instance.log("bag_recorder").count("stopped recording") == 1 and instance.stop("bag_recorder") == 0
    assert counts(path)[MOTORS] == kept
    assert len(bags(instance)) == 2


def test_what_was_lost_while_the_recorder_stood_is_counted(instance: RunningInstance) -> None:
    path = recorder(instance)
    publisher = MOTOR.publisher(instance.node())
    kit.connect(path, publisher, motor(0))
    process = psutil.Process(instance.process("bag_recorder").pid)
    process.suspend()
    message = motor(1)
    for _ in range(4 * QUEUE):
        publisher.publish(message)
    process.resume()
    last = 0

    def received() -> bool:
        nonlocal last
        last = publisher.publish(message)
        time.sleep(0.1)
        return newest(path, MOTORS) > 4 * QUEUE

    wait_until(received, 60.0, "the recorder goes on")
    wait_until(lambda: newest(path, MOTORS) == last, 20.0, "to the last message", 0.3)
    assert instance.stop("bag_recorder") == 0
    first = kit.sequences(path, MOTORS)[0]
    reported = json.loads(metadata(path, "topics")[0][MOTORS])
    assert reported["dropped"] > 0 and reported["received"] == reported["written"]
    assert reported["received"] + reported["dropped"] == last - first + 1
