"""Calibrate arms of a robot that stands: through poses by the VRC's trajectory controllers, and back; then find."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import accumulate

from valor.calibration.identify import Found, identify
from valor.calibration.poses import Poses
from valor.calibration.record import Record, Recorder
from valor.common.arrays import FloatArray
from valor.common.behaviors import ControlMode
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.robot.description import RobotDescription
from valor.robot.model import full_model
from valor.valorctl import control_mode
from valor.valorctl.arm_listener import ArmListener
from valor.valorctl.arm_motion import follow_by, trajectory_duration
from valor.valorctl.interruption import InterruptedBySignalError, Interruption
from valor.valorctl.node import join
from valor.valorctl.ros_client import RosClient

PAUSE = 0.3  # in a pose [robot time, s]
MODE = ControlMode.STAND_MANIPULATE
LOOK = 0.02  # [s]

Bar = Callable[[float], AbstractContextManager[Callable[[float], None]]]


@dataclass(frozen=True)
class Order:
    """How arms are to be calibrated: through so many poses, at a share of the joints' speed."""

    poses: int
    speed: float


@dataclass
class _Way:
    """An arm's way through poses (m,) [rad], and how long each takes [robot time, s]; how many it has been in."""

    group: str
    poses: Poses
    goals: list[FloatArray]
    durations: list[float]
    reached: int = 0

    @property
    def whole(self) -> float:
        """All of it [s]."""
        return sum(self.durations) + PAUSE * len(self.goals)


class ArmCalibrating:
    """The arms of an instance's robot, one after the other; used once."""

    def __init__(self, instance: Instance, robot: RobotDescription, order: Order, interruption: Interruption) -> None:
        self._instance, self._robot, self._order = instance, robot, order
        self._interruption = interruption
        self._listener: ArmListener | None = None

    def run(self, groups: Sequence[str], stage: Callable[[str], None], bar: Bar) -> dict[str, Found]:
        """Move arms, and find what they are.

        Args:
            groups: of robot.yaml, such as ``left_arm``.
            stage: told what is done now.
            bar: shows how much of so long is done [robot time, s].

        Raises:
            ValorError: an arm cannot be led, or could not go on; it is held where it is then.
            InterruptedBySignalError: it is back where it was.
        """
        records: dict[str, Record] = {}
        with join(self._instance) as node:
            stage("choosing poses")
            self._listener = ArmListener(node, self._robot)
            ways = [self._plan(self._listener, group) for group in groups]
            with (
                self._manipulating(),
                RosClient(self._instance, self._check) as ros,
                bar(sum(way.whole for way in ways)) as shown,
            ):
                for way, before in zip(ways, accumulate((way.whole for way in ways), initial=0.0), strict=False):
                    records[way.group] = self._measure(self._listener, ros, way, partial(_add, shown, before))
        stage("finding")
        model = full_model(self._robot)
        found = {}
        for group, record in records.items():
            self._interruption.check()
            found[group] = identify(model, group, record, self._order.poses)
        self._interruption.check()
        return found

    def _check(self) -> None:
        self._interruption.check()
        if self._listener is not None:
            self._listener.check()

    def _plan(self, listener: ArmListener, group: str) -> _Way:
        """Choose an arm's poses.

        Raises:
            ValorError: it cannot be led now, or nowhere.
        """
        listener.group = group
        listener.require_free()
        listener.require_still(self._interruption.check)
        arm = self._robot.group_indices(group)
        position = listener.now.joint_position
        chooser = Poses(full_model(self._robot, "collision"), group, position)
        goals: list[FloatArray] = []
        durations: list[float] = []
        at = position[arm]
        for _ in range(self._order.poses):
            self._check()
            goals.append(chooser.next())
            durations.append(self._duration(group, at, goals[-1]))
            at = goals[-1]
        return _Way(group, chooser, goals, durations)

    @contextmanager
    def _manipulating(self) -> Iterator[None]:
        """In the mode that takes arms, and afterwards in the one before; not where something else ended it."""
        before = control_mode.report(self._instance).current_control_mode
        if before == MODE:
            yield
            return
        control_mode.enter(self._instance, MODE, self._interruption.check)
        try:
            yield
        except InterruptedBySignalError:
            control_mode.enter(self._instance, before)
            raise
        control_mode.enter(self._instance, before, self._interruption.check)

    def _measure(self, listener: ArmListener, ros: RosClient, way: _Way, shown: Callable[[float], None]) -> Record:
        """Move an arm through its poses, and back; ``shown`` is told how much is done [s]."""
        listener.group = way.group
        listener.require_still(self._interruption.check)
        if not way.poses.clear(listener.now.joint_position, way.goals[0]):
            raise ValorError(
                f"calibrate {way.group.replace('_', ' ')}: it was moved meanwhile, and has no way from there"
            )
        recorder = listener.recorder = Recorder(self._robot)
        began = listener.time
        listener.tell = lambda: shown(min(listener.time - began, way.whole))
        try:
            for goal, duration in zip(way.goals, way.durations, strict=True):
                self._go(ros, way.group, goal, duration)
                way.reached += 1
                self._wait(listener, PAUSE)
        except InterruptedBySignalError:
            with Interruption() as self._interruption:  # a second one, and the arm holds
                self._go_back(listener, ros, way)
            raise
        except ValorError as error:
            raise ValorError(f"{error}; the arm stays where it is") from None
        self._go_back(listener, ros, way)
        listener.recorder = None
        return recorder.record()

    def _go_back(self, listener: ArmListener, ros: RosClient, way: _Way) -> None:
        for goal in way.poses.back(listener.place, way.reached):
            self._go(ros, way.group, goal, self._duration(way.group, listener.place, goal))

    def _go(self, ros: RosClient, group: str, goal: FloatArray, duration: float) -> None:
        joints = self._robot.tables.group(group)
        follow_by(ros, group, dict(zip(joints, goal.tolist(), strict=True)), duration, tolerant=True)

    def _wait(self, listener: ArmListener, seconds: float) -> None:
        """So long in robot time."""
        until = listener.time + seconds
        while listener.time < until:
            self._check()
            time.sleep(LOOK)

    def _duration(self, group: str, start: FloatArray, goal: FloatArray) -> float:
        joints = self._robot.tables.group(group)
        begin, end = (dict(zip(joints, each.tolist(), strict=True)) for each in (start, goal))
        return trajectory_duration(self._robot, begin, end, self._order.speed)


def _add(shown: Callable[[float], None], before: float, more: float) -> None:
    shown(before + more)
