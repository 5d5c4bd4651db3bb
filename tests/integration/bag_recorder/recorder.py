"""A recorder under test: started, spoken to, and its bags read, finished or not."""

import shutil
import threading
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.records import Message
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

import bifrost
from harness.instance import RunningInstance
from harness.waiting import wait_until
from valor.bags.recovery import recover
from valor.common.messages import Motor
from valor.common.topics import JOINT_SETPOINTS, MOTOR

JOINTS = 38
SECOND = 1_000_000_000
MOTORS, SETPOINTS = "/bifrost/" + MOTOR.name, "/bifrost/" + JOINT_SETPOINTS.name
RELIABLE = QoSProfile(depth=1000)
BEST_EFFORT = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
KEPT = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def motor(sequence: int) -> Motor:
    """A message that compresses badly, as real ones do."""
    values = np.random.default_rng(sequence).normal(size=(5, JOINTS))
    return Motor(7, sequence, 3, np.full(JOINTS, 2, np.uint8), *values, "stand", 1)  # type: ignore[call-arg]


def bags(instance: RunningInstance) -> list[Path]:
    return sorted(instance.instance.bags.rglob("*.mcap"), key=lambda path: path.stat().st_ctime_ns)


def read(path: Path) -> list[tuple[str, Message]]:
    """Topics and messages that the file holds by now, finished or not."""
    copy = path.with_suffix(".copy")
    shutil.copyfile(path, copy)
    recover(copy)
    with open(copy, "rb") as file:
        found = [(channel.topic, message) for _, channel, message in make_reader(file).iter_messages()]
    copy.unlink()
    return found


def counts(path: Path) -> Counter[str]:
    return Counter(topic for topic, _ in read(path))


def messages(path: Path, topic: str) -> list[Message]:
    return [message for each, message in read(path) if each == topic]


def sequences(path: Path, topic: str) -> list[int]:
    return [message.sequence for message in messages(path, topic)]


def newest(path: Path, topic: str) -> int:
    return (sequences(path, topic) or [0])[-1]


def has(path: Path, topic: str, number: int) -> bool:
    return counts(path)[topic] >= number


def recorder(instance: RunningInstance) -> Path:
    """Start the recorder; returns its bag."""
    before = set(bags(instance))
    instance.start("bag_recorder")
    instance.wait_ready("bag_recorder")
    (path,) = set(bags(instance)) - before
    return path


def connect(path: Path, publisher: bifrost.Publisher[Any], message: bifrost.Message) -> int:
    """Publish until the recorder receives: what comes before is lost, and rightly so. Returns how many it received."""
    topic = "/bifrost/" + publisher.topic
    sent = []

    def received() -> bool:
        sent.append(publisher.publish(message))
        return len(sent) % 10 == 0 and has(path, topic, 1)

    wait_until(received, 20.0, f"the recorder hears {publisher.topic}", 0.05)
    wait_until(lambda: newest(path, topic) == sent[-1], 20.0, "and all that was said so far", 0.2)
    return counts(path)[topic]


def metadata(path: Path, name: str) -> list[dict[str, str]]:
    with open(path, "rb") as file:
        return [record.metadata for record in make_reader(file).iter_metadata() if record.name == name]


class Stream(threading.Thread):
    """Publishes Motor at a steady rate until stopped."""

    def __init__(self, publisher: bifrost.Publisher[Motor], rate: float) -> None:
        super().__init__(daemon=True)
        self._publisher, self._period = publisher, 1.0 / rate
        self.stopping = threading.Event()
        self.sent: list[int] = []  # sequences

    def run(self) -> None:
        sequence = 0
        while not self.stopping.wait(self._period):
            sequence = self._publisher.publish(motor(sequence))
            self.sent.append(sequence)

    def stop(self) -> None:
        self.stopping.set()
        self.join()
