"""When a message was sent, as the bag has it: Bifrost's stamps by the offset, ROS' without what the clock has moved."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import rclpy
from mcap.reader import make_reader
from rclpy.context import Context
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from std_msgs.msg import String
from valor_msgs.msg import VelocityCommand as Twin

from harness.instance import RunningInstance
from harness.waiting import wait_until
from valor.bag_recorder.bag import SHARE, Bag
from valor.bag_recorder.bifrost_tap import BifrostTap
from valor.bag_recorder.clock import WallClock, measure_offset
from valor.bag_recorder.ros_tap import RosTap
from valor.bags.selection import EVERYTHING
from valor.common.messages import VelocityCommand
from valor.common.topics import VELOCITY

HOUR = 3_600_000_000_000  # [ns]
SLACK = 50_000_000  # of reading two clocks one after the other on a busy computer [ns]


@pytest.fixture
def ros(instance: RunningInstance, monkeypatch: pytest.MonkeyPatch) -> Iterator[Node]:
    for name, value in instance.instance.environment().items():
        monkeypatch.setenv(name, value)
    context = Context()
    rclpy.init(context=context, domain_id=instance.settings.ros_domain_id)
    node = rclpy.create_node("test", context=context)
    yield node
    node.destroy_node()
    context.try_shutdown()


def test_a_recorder_that_takes_much_gives_signs_of_life(instance: RunningInstance, home: Path) -> None:
    signs = 0

    def alive() -> None:
        nonlocal signs
        signs += 1

    tap = BifrostTap(instance.node("recorder"), WallClock(), [VELOCITY], alive=alive)
    publisher = VELOCITY.publisher(instance.node("speaker"))
    bag = Bag(home / "much.mcap")

    def taken_at_once() -> int:
        nonlocal signs
        signs, before = 0, tap.counts[f"/bifrost/{VELOCITY.name}"][0]
        for _ in range(500):
            publisher.publish(VelocityCommand(5, 0.1, 0.2, 0.3))
        tap.drain(bag)
        return tap.counts[f"/bifrost/{VELOCITY.name}"][0] - before

    wait_until(lambda: taken_at_once() > 3 * SHARE and signs > 3, 20.0, "much to take, and signs of life meanwhile")
    bag.close()


def test_stamps_of_bifrost_are_brought_to_the_wall_clock_of_the_start(instance: RunningInstance, home: Path) -> None:
    wall = WallClock()
    wall.offset += HOUR  # another computer's would differ by as much
    tap = BifrostTap(instance.node("recorder"), wall, [VELOCITY])
    wall.drift = 7 * HOUR  # set meanwhile: intervals between messages stay exact
    publisher = VELOCITY.publisher(instance.node("speaker"))
    bag = Bag(home / "stamps.mcap")
    first = time.time_ns()

    def heard() -> bool:
        publisher.publish(VelocityCommand(5, 0.1, 0.2, 0.3))
        tap.drain(bag)
        return bag.written.get(f"/bifrost/{VELOCITY.name}", 0) > 3

    wait_until(heard, 20.0, "the recorder hears")
    last = time.time_ns()
    bag.close()
    with open(bag.path, "rb") as file:
        messages = [message for _, _, message in make_reader(file).iter_messages()]
    times = [message.log_time for message in messages]
    assert first + HOUR - SLACK <= min(times) and max(times) <= last + HOUR + SLACK
    assert times == sorted(times) == [message.publish_time for message in messages]
    for message in messages:
        stamp = deserialize_message(message.data, Twin).header.stamp
        assert stamp.sec * 1_000_000_000 + stamp.nanosec == message.log_time


def test_stamps_of_ros_are_taken_back_by_what_the_wall_clock_has_moved(
    instance: RunningInstance, ros: Node, home: Path
) -> None:
    wall = WallClock()
    node = rclpy.create_node("bag_recorder", context=ros.context)
    tap = RosTap(node, wall, EVERYTHING)
    try:
        publisher = ros.create_publisher(String, "/said", 10)
        bag = Bag(home / "stamps.mcap")

        def listening() -> bool:
            tap.discover()
            return bool(publisher.get_subscription_count())

        wait_until(listening, 20.0, "the recorder subscribes")
        bounds = []
        for drift in (0, 5 * HOUR, -3 * HOUR):
            wall.drift = drift
            before, known = time.time_ns(), bag.written.get("/said", 0)

            def heard(known: int = known) -> bool:
                tap.drain(bag)
                return bag.written.get("/said", 0) > known

            publisher.publish(String(data=str(drift)))
            wait_until(heard, 20.0, "the message")
            bounds.append((before - drift, time.time_ns() - drift))
        bag.close()
    finally:
        node.destroy_node()
    with open(bag.path, "rb") as file:
        messages = [message for _, channel, message in make_reader(file).iter_messages(log_time_order=False)
                    if channel.topic == "/said"]  # fmt: skip
    for message, (earliest, latest) in zip(messages, bounds, strict=True):
        assert earliest - SLACK <= message.publish_time <= message.log_time <= latest + SLACK


def test_the_offset_is_read_between_the_two_looks_that_lie_closest(monkeypatch: pytest.MonkeyPatch) -> None:
    """A reading that was interrupted says little: its wall clock is from any moment in between."""
    rng = np.random.default_rng(0)
    gaps = rng.permutation(np.arange(1, 21) * 1_000_000)
    now, asked, waiting = 1_000_000_000, 0, False

    def monotonic_ns() -> int:
        nonlocal now, asked, waiting
        if waiting:
            now += int(gaps[asked % 20])
            asked += 1
        waiting = not waiting
        return now

    def time_ns() -> int:
        return HOUR + now + int(gaps[asked % 20]) // 4  # a quarter of the gap has passed

    monkeypatch.setattr("valor.bag_recorder.clock.time.monotonic_ns", monotonic_ns)
    monkeypatch.setattr("valor.bag_recorder.clock.time.time_ns", time_ns)
    assert measure_offset() == HOUR + 250_000 - 500_000
    assert asked == 20
