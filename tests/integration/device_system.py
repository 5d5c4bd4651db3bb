"""A robot on its emulated devices, with who controls its motion, and without the ROS side."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.conftest import RunningInstance, fresh_instance, wait_until
from valor_common.messages import BehaviorReply, BehaviorRequest, DeviceStatus, MotionState
from valor_common.topics import BEHAVIOR, DEVICES, MOTION_STATE, STATISTICS

PATIENCE = 60.0  # [s]
_BEFORE = {"freeze": "stand_prep", "idle": "stand_prep", "soft_stop": "stand", "stand_prep": "stand"}


class RobotOnDevices:
    """What devices and Motion System say, and a way from one behavior to another."""

    def __init__(self, running: RunningInstance) -> None:
        node = running.node()
        self._devices = node.subscriber(DEVICES.name, DeviceStatus)
        self._states = node.subscriber(MOTION_STATE.name, MotionState)
        self._behavior = node.client(BEHAVIOR.name, BehaviorRequest, BehaviorReply)
        self._status: DeviceStatus | None = None
        self._state: MotionState | None = None
        self.running = running
        self.node = node

    @property
    def status(self) -> DeviceStatus:
        """The newest word on the devices."""
        if received := self._devices.latest() or (self._status is None and self._devices.receive(PATIENCE)):
            self._status = received.message
        assert self._status is not None
        return self._status

    @property
    def state(self) -> MotionState:
        """The Motion System's newest."""
        if received := self._states.latest() or (self._state is None and self._states.receive(PATIENCE)):
            self._state = received.message
        assert self._state is not None
        return self._state

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
def on_devices(ros_domain: int, *drivers: str, **settings: object) -> Iterator[RunningInstance]:
    """The hardware variant at 250 Hz: the emulators and drivers, then, when these are ready, what needs them."""
    with (
        tempfile.TemporaryDirectory(prefix="valor-", ignore_cleanup_errors=True) as home,
        fresh_instance(Path(home), ros_domain) as running,
    ):
        running.configure(variant="hardware", control_rate=250.0, epoch=time.monotonic_ns(), **settings)
        for processes in (("device_emulators", *drivers), ("comms_manager", "motion_manager")):
            for name in processes:
                running.start(name)
            for name in processes:
                if name in STATISTICS:
                    running.wait_ready(name, PATIENCE)
        yield running
