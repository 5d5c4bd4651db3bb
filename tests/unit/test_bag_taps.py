"""Stamps in a bag: Bifrost's by the offset, ROS' without the clock's drift; reports of clock changes."""

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rclpy
from mcap.reader import make_reader
from mcap.records import Message
from rclpy.context import Context
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from std_msgs.msg import String
from valor_msgs.msg import VelocityCommand as Twin

from harness.instance import RunningInstance
from harness.waiting import wait_until
from valor.bag_recorder import clock
from valor.bag_recorder.bag import SHARE, Bag
from valor.bag_recorder.bifrost_tap import BifrostTap
from valor.bag_recorder.clock import StampConverter, measure_offset
from valor.bag_recorder.ros_tap import RosTap
from valor.bags.selection import EVERYTHING
from valor.common.messages import BalanceWeights, VelocityCommand
from valor.common.topics import BALANCE_WEIGHTS, VELOCITY

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


def messages_of(bag: Bag, topic: str) -> list[Message]:
    with open(bag.path, "rb") as file:
        return [message for _, _, message in make_reader(file).iter_messages([topic], log_time_order=False)]


def test_the_watchdog_is_called_during_long_work(instance: RunningInstance, home: Path) -> None:
    signs: list[None] = []
    tap = BifrostTap(instance.node("recorder"), StampConverter(), [VELOCITY], alive=lambda: signs.append(None))
    publisher = VELOCITY.publisher(instance.node("speaker"))
    bag = Bag(home / "much.mcap")

    def received_at_once() -> int:
        signs.clear()
        before = tap.counts[f"/bifrost/{VELOCITY.name}"][0]
        for _ in range(500):
            publisher.publish(VelocityCommand(5, 0.1, 0.2, 0.3))
        tap.drain(bag)
        return tap.counts[f"/bifrost/{VELOCITY.name}"][0] - before

    wait_until(lambda: received_at_once() > 3 * SHARE and len(signs) > 3, 20.0, "many messages, and signs of life")
    bag.close()


def test_bifrost_stamps_are_converted_by_the_offset_of_the_start(instance: RunningInstance, home: Path) -> None:
    wall = StampConverter()
    wall.offset += HOUR  # another computer's would differ by as much
    tap = BifrostTap(instance.node("recorder"), wall, [VELOCITY])
    wall.drift = 7 * HOUR  # set meanwhile: intervals between messages stay exact
    publisher = VELOCITY.publisher(instance.node("speaker"))
    bag = Bag(home / "stamps.mcap")
    first = time.time_ns()

    def received() -> bool:
        publisher.publish(VelocityCommand(5, 0.1, 0.2, 0.3))
        tap.drain(bag)
        return bag.written.get(f"/bifrost/{VELOCITY.name}", 0) > 3

    wait_until(received, 20.0, "the recorder hears")
    last = time.time_ns()
    bag.close()
    messages = messages_of(bag, f"/bifrost/{VELOCITY.name}")
    times = [message.log_time for message in messages]
    assert first + HOUR - SLACK <= min(times) and max(times) <= last + HOUR + SLACK
    assert times == sorted(times) == [message.publish_time for message in messages]
    for message in messages:
        stamp = deserialize_message(message.data, Twin).header.stamp
        assert stamp.sec * 1_000_000_000 + stamp.nanosec == message.log_time


def test_the_drift_is_subtracted_from_ros_stamps(instance: RunningInstance, ros: Node, home: Path) -> None:
    wall = StampConverter()
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

            def received(known: int = known) -> bool:
                tap.drain(bag)
                return bag.written.get("/said", 0) > known

            publisher.publish(String(data=str(drift)))
            wait_until(received, 20.0, "the message")
            bounds.append((before - drift, time.time_ns() - drift))
        bag.close()
    finally:
        node.destroy_node()
    for message, (earliest, latest) in zip(messages_of(bag, "/said"), bounds, strict=True):
        assert earliest - SLACK <= message.publish_time <= message.log_time <= latest + SLACK


def test_the_offset_is_read_between_the_closest_readings(monkeypatch: pytest.MonkeyPatch) -> None:
    """An interrupted reading is inaccurate: its wall clock is from any moment in between."""
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


def test_a_topic_keeps_every_nth_message_or_none(instance: RunningInstance, home: Path) -> None:
    third, none = replace(VELOCITY, record_every=3), replace(BALANCE_WEIGHTS, record_every=0)
    tap = BifrostTap(instance.node("recorder"), StampConverter(), (third, none))
    bag = Bag(home / "a.mcap")
    node = instance.node()
    velocities, weights = VELOCITY.publisher(node), BALANCE_WEIGHTS.publisher(node)

    def all_received() -> bool:
        tap.drain(bag)
        velocities.publish(VelocityCommand(0, 0.0, 0.0, 0.0))
        weights.publish(BalanceWeights([], np.zeros(0)))
        return tap.counts[f"/bifrost/{VELOCITY.name}"][0] >= 30

    wait_until(all_received, 20.0, "thirty messages")
    bag.close()
    with open(bag.path, "rb") as file:
        kept = [(channel.topic, message.sequence) for _, channel, message in make_reader(file).iter_messages()]
    assert {topic for topic, _ in kept} == {f"/bifrost/{VELOCITY.name}"}
    sequences = [sequence for _, sequence in kept]
    assert sequences == list(range(sequences[0], sequences[-1] + 1, 3))
    assert all(sequence % 3 == 0 for sequence in sequences) and len(sequences) >= 9
    assert {dropped for _, dropped in tap.counts.values()} == {0}


def test_setting_the_clock_is_a_step_and_slewing_is_drift(monkeypatch: pytest.MonkeyPatch) -> None:
    wall = StampConverter()
    start = wall.offset
    assert not wall.moved()
    reported = []
    for moved in (999_999, 10_000_000, 10_999_999, 3_600_000_000_000, 3_600_001_500_000, 0):
        monkeypatch.setattr(clock, "measure_offset", lambda moved=moved: start + moved)
        reported.append(wall.check())
        assert (wall.offset, wall.drift) == (start, moved)
    assert [change and change.kind for change in reported] == [None, "drift", None, "step", "drift", "step"]
    assert wall.steps == 2 and wall.metadata()["steps"] == "2"
    wall.drift = 3_600_000_000_000  # as if the clock had been set back by an hour since
    assert wall.moved()
