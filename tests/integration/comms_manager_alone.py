"""A Comms Manager of a simulation with no Motion Manager: a client in its place, and what is received meanwhile."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

import bifrost
from harness.instance import RunningInstance
from harness.places import REPOSITORY
from harness.waiting import PATIENCE, wait_until
from valor.common.messages import GroundTruth
from valor.common.topics import CLOCK, GROUND_TRUTH, STATISTICS, Topic

M = TypeVar("M", bound=bifrost.Message)


def start(instance: RunningInstance, **settings: object) -> None:
    """A Comms Manager with some settings, up to its word that it is ready."""
    instance.configure(**settings)
    instance.start("comms_manager", wait=True)


class Newest(Generic[M]):
    """The newest message of a topic; waits for the first one only, so that whoever drives the world is not stalled."""

    def __init__(self, node: bifrost.Node, topic: Topic[M]) -> None:
        self._subscriber = topic.subscriber(node)
        self._newest: bifrost.Received[M] | None = None

    def received(self) -> bifrost.Received[M]:
        received = self._subscriber.latest()
        if received is None and self._newest is None:
            received = self._subscriber.receive(timeout=PATIENCE)
            assert received is not None, f"nothing on {self._subscriber.topic} within {PATIENCE:g} s"
        if received is not None:
            self._newest = received
        assert self._newest is not None
        return self._newest

    def __call__(self) -> M:
        return self.received().message


class Watch:
    def __init__(self, node: bifrost.Node) -> None:
        self.clock = Newest(node, CLOCK)
        self.statistics = Newest(node, STATISTICS["comms_manager"])
        self.truth = Newest(node, GROUND_TRUTH)

    def truth_at(self, robot_time: float, timeout: float = 300.0) -> GroundTruth:
        """The first truth received at or after a robot time [s], while others drive the world."""
        wait_until(lambda: self.truth().time >= robot_time * 1e9, timeout, f"{robot_time:g} s of robot time")
        return self.truth()


@contextmanager
def client_process(instance: RunningInstance) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.integration.servo_client"], cwd=REPOSITORY, env=instance.environment
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()
