"""A robot on its emulated devices, with who controls its motion, and without the ROS side."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from harness.instance import RunningInstance, fresh_instance
from harness.waiting import PATIENCE, some, wait_until
from tests.integration.comms_manager_alone import Newest
from valor.common import messages
from valor.common.messages import BehaviorRequest, DeviceStatus, FaultRequest, JointSetpoints, MotionState
from valor.common.topics import BEHAVIOR, DEVICES, FAULT, JOINT_SETPOINTS, MOTION_STATE, PROPRIOCEPTOR, STATISTICS
from valor.robot.description import RobotDescription

SPEED = 1.0  # of joints that are led [rad/s]
NEAR = 0.05  # tolerance of goals [rad]
_BEFORE = {"freeze": "stand_prep", "idle": "stand_prep", "soft_stop": "stand", "stand_prep": "stand"}


class RobotOnDevices:
    """What devices and Motion System say, and a way from one behavior to another."""

    def __init__(self, running: RunningInstance) -> None:
        self.running = running
        self.node = running.node()
        self._status = Newest(self.node, DEVICES)
        self._state = Newest(self.node, MOTION_STATE)
        self._behavior = BEHAVIOR.client(self.node)
        self._measured = PROPRIOCEPTOR.subscriber(self.node)
        self._setpoints = JOINT_SETPOINTS.publisher(self.node)
        self._fault = FAULT.client(self.node)
        self.robot = RobotDescription.load(running.settings.robot)

    def measured(self) -> messages.Proprioceptor:
        return some(self._measured.receive(PATIENCE)).message

    def unit(self, name: str) -> tuple[str, str, float]:
        """State, detail and errors of a unit."""
        status = self.status
        index = status.units.index(name)
        return status.states[index], status.details[index], float(status.errors[index])

    def fail(self, unit: str, fault: str, duration: float = 0.0) -> None:
        """Let a unit fail; an empty fault ends all faults of its device."""
        device, _, name = unit.partition("/")
        reply = self._fault.call(FaultRequest(device, name or device, fault, duration), timeout=PATIENCE)
        assert reply.accepted, reply.reason

    def lead(self, goal: Mapping[str, float], done: Callable[[], object] | None = None) -> None:
        """Lead joints to a goal [rad], until ``done`` (default: they are there)."""
        indices = [self.robot.index[name] for name in goal]
        end, still = np.array(list(goal.values())), np.zeros(len(goal))
        begin = self.measured().joint_position[indices]
        began, duration = self.state.time, max(0.1, float(np.abs(end - begin).max()) / SPEED)

        def there() -> bool:
            now = self.state.time
            share = min(1.0, 1e-9 * (now - began) / duration)
            self._setpoints.publish(JointSetpoints(now, list(goal), begin + share * (end - begin), still, still))
            if done is not None:
                return share == 1.0 and bool(done())
            return share == 1.0 and bool(np.abs(self.measured().joint_position[indices] - end).max() < NEAR)

        wait_until(there, PATIENCE, f"{', '.join(goal)} at the goal", period=0.01)

    @property
    def status(self) -> DeviceStatus:
        return self._status()

    @property
    def state(self) -> MotionState:
        return self._state()

    @property
    def behavior(self) -> str:
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
    """The hardware variant at a rate that leaves a busy computer time: emulators and drivers, then what needs them."""
    with (
        tempfile.TemporaryDirectory(prefix="valor-", ignore_cleanup_errors=True) as home,
        fresh_instance(
            Path(home), variant="hardware", control_rate=125.0, epoch=time.monotonic_ns(), **settings
        ) as running,
    ):
        for processes in (("device_emulators", *drivers), ("comms_manager", "motion_manager")):
            for name in processes:
                running.start(name)
            for name in processes:
                if name in STATISTICS:
                    running.wait_ready(name, PATIENCE)
        yield running
