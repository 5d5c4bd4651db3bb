"""A robot on its emulated devices, with who controls its motion, and without the ROS side."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Generic, TypeVar

import bifrost
from harness.instance import RunningInstance, fresh_instance
from harness.waiting import PATIENCE, wait_until
from valor.common.messages import BehaviorRequest, DeviceStatus, MotionState
from valor.common.topics import BEHAVIOR, DEVICES, MOTION_STATE, STATISTICS

M = TypeVar("M", bound=bifrost.Message)
_BEFORE = {"freeze": "stand_prep", "idle": "stand_prep", "soft_stop": "stand", "stand_prep": "stand"}


class Newest(Generic[M]):
    """The newest message of a topic, whenever asked."""

    def __init__(self, subscriber: bifrost.Subscriber[M]) -> None:
        self._subscriber = subscriber
        self._message: M | None = None

    def __call__(self) -> M:
        """It; waits for the first."""
        received = self._subscriber.latest()
        if received is None and self._message is None:
            received = self._subscriber.receive(PATIENCE)
        if received is not None:
            self._message = received.message
        assert self._message is not None
        return self._message


class RobotOnDevices:
    """What devices and Motion System say, and a way from one behavior to another."""

    def __init__(self, running: RunningInstance) -> None:
        self.running = running
        self.node = running.node()
        self._status = Newest(DEVICES.subscriber(self.node))
        self._state = Newest(MOTION_STATE.subscriber(self.node))
        self._behavior = BEHAVIOR.client(self.node)

    @property
    def status(self) -> DeviceStatus:
        """The newest word on the devices."""
        return self._status()

    @property
    def state(self) -> MotionState:
        """The Motion System's newest."""
        return self._state()

    @property
    def behavior(self) -> str:
        """Of the Motion System."""
        return self.state.behavior

    def go(self, behavior: str) -> None:
        """To a behavior, by way of those that lead there: a busy computer may have had the robot held meanwhile."""
        refusals: dict[str, str] = {}

        def there() -> bool:
            now = self.behavior
            if now != behavior:
                wanted = _BEFORE.get(now, behavior)
                refusals[wanted] = self._behavior.call(BehaviorRequest(wanted), timeout=PATIENCE).reason
            return now == behavior

        try:
            wait_until(there, PATIENCE, behavior, period=0.1)
        except AssertionError as error:
            raise AssertionError(f"{error}, but {self.behavior}: {refusals}; {self.status}") from None


@contextmanager
def on_devices(*drivers: str, **settings: Any) -> Iterator[RunningInstance]:
    """The hardware variant at 250 Hz: the emulators and drivers, then, when these are ready, what needs them."""
    with (
        tempfile.TemporaryDirectory(prefix="valor-", ignore_cleanup_errors=True) as home,
        fresh_instance(
            Path(home), variant="hardware", control_rate=250.0, epoch=time.monotonic_ns(), **settings
        ) as running,
    ):
        for processes in (("device_emulators", *drivers), ("comms_manager", "motion_manager")):
            for name in processes:
                running.start(name)
            for name in processes:
                if name in STATISTICS:
                    running.wait_ready(name, PATIENCE)
        yield running
