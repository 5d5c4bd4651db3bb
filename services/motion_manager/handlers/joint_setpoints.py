"""``motion_manager/joint_setpoints``: whole messages are followed or refused, never parts of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from math import isfinite
from typing import Self

import numpy as np
import numpy.typing as npt

from bifrost import Received
from valor.common.errors import RefusalError
from valor.common.messages import JointSetpoints
from valor.common.topics import JOINT_SETPOINTS
from valor.motion_manager.handlers.handler import STALE, Handler
from valor.motion_manager.handlers.rejections import Rejections
from valor.motion_manager.hands.hand_goals import SIDES, HandGoals
from valor.motion_manager.joints.joint_reference import Setpoint
from valor.motion_manager.joints.upper_body import UpperBody
from valor.motion_manager.parts import Parts
from valor.motion_manager.states.behavior_fsm import BehaviorFsm
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription

AHEAD = 0.1  # a set-point for a state that is so far from having been is refused [s of robot time]
_LAYOUTS = 64  # name lists remembered


@dataclass(frozen=True, slots=True)
class Layout:
    """What a list of names means: places in the joint vectors, and the internal FSMs that own them."""

    names: list[str]
    joints: npt.NDArray[np.intp]
    machines: frozenset[type[StrEnum]]
    first_of: dict[type[StrEnum], str]  # a joint of each, to name in refusals
    limits: CommandedLimits  # of these joints


class JointSetpointsHandler(Handler[JointSetpoints]):
    """Checks set-points, brings them within the limits and hands them to the upper body.

    They are stale or not by robot time, which all computers share; a Proprioceptor that was before this Motion
    Manager took the robot over makes them as stale as an old one.
    """

    topic = JOINT_SETPOINTS

    def __init__(
        self,
        robot: RobotDescription,
        fsm: BehaviorFsm,
        upper_body: UpperBody,
        hand_goals: HandGoals,
        rejections: Rejections,
        *,
        taken_over: Callable[[], int],
    ) -> None:
        """``taken_over``: gives the robot time at which this Motion Manager took the robot over [ns]."""
        super().__init__(rejections)
        self._index = robot.index
        self._limits = CommandedLimits.of_joints(robot)
        self._fsm = fsm
        self._upper_body = upper_body
        self._taken_over = taken_over
        self._hand_goals = hand_goals
        self._arms = [set(robot.group_indices(f"{side}_arm").tolist()) for side in SIDES]
        self._layouts: dict[tuple[str, ...], Layout] = {}
        self._layout_before: Layout | None = None  # of the message before

    @classmethod
    def of(cls, parts: Parts) -> Self:
        """The one of a Motion Manager."""
        custody = parts.custody
        return cls(
            parts.robot,
            parts.fsm,
            parts.upper_body,
            parts.hand_goals,
            parts.rejections,
            taken_over=lambda: custody.since,
        )

    def obey(self, received: Received[JointSetpoints], now: int) -> None:
        """Have joints follow."""
        message = received.message
        layout = self._layout(message.names)
        self._check_time(message.time, now)
        count = layout.joints.size
        position, velocity, acceleration = message.position, message.velocity, message.acceleration
        if not len(position) == len(velocity) == len(acceleration) == count:
            raise RefusalError("length", _wrong_length(message, count))
        # A sum of squares is finite only if its terms are: most messages are looked at no further.
        squares = position.dot(position) + velocity.dot(velocity) + acceleration.dot(acceleration)
        if not isfinite(squares) and (reason := _not_finite(message)):
            raise RefusalError("finite", reason)
        for machine in layout.machines:
            if closed := self._upper_body.closed(machine):
                raise RefusalError(
                    "closed",
                    f"joint {layout.first_of[machine]!r} is closed to set-points in behavior "
                    f"{self._fsm.behavior}: {closed}",
                )
        for side, arm in enumerate(self._arms):
            if self._hand_goals.moves(side, now * 1e-9) and (arm & set(layout.joints.tolist())):
                raise RefusalError("hand_goal", f"the {SIDES[side]} arm follows a hand goal")
        limits = layout.limits
        setpoint = Setpoint(
            layout.joints,
            position=limits.position_within(position),
            velocity=limits.velocity_within(velocity),
            acceleration=limits.acceleration_within(acceleration),
            time=message.time * 1e-9,
        )
        self._upper_body.follow(layout.machines, setpoint, now * 1e-9, received.sequence)

    def _check_time(self, time: int, now: int) -> None:
        age = (now - time) * 1e-9
        if age > STALE:
            raise RefusalError("stale", f"stale: made for a state {age:.3f} s old; expected at most {STALE} s")
        if time < self._taken_over():
            raise RefusalError("taken_over", "stale: made before this Motion Manager took the robot over")
        if age < -AHEAD:
            raise RefusalError("ahead", f"made for a state {-age:.3f} s ahead of robot time; another world's?")

    def _layout(self, names: list[str]) -> Layout:
        before = self._layout_before
        if before is not None and names == before.names:
            return before  # nearly always, and without hashing every name
        layout = self._layout_before = self._known(names)
        return layout

    def _known(self, names: list[str]) -> Layout:
        key = tuple(names)
        if (known := self._layouts.get(key)) is not None:
            return known
        if not names:
            raise RefusalError("names", "names no joint")
        first_of: dict[type[StrEnum], str] = {}
        seen: set[str] = set()
        for name in names:
            if name not in self._index:
                raise RefusalError("names", f"unknown joint {name[:64]!r}; joints are named in robot.yaml")
            if name in seen:
                raise RefusalError("names", f"joint {name!r} is named twice")
            seen.add(name)
            if name not in self._upper_body.owners:
                raise RefusalError("names", f"joint {name!r} is in no group that moves; it is held at nominal")
            first_of.setdefault(self._upper_body.owners[name], name)
        joints = np.array([self._index[name] for name in names], dtype=np.intp)
        layout = Layout(names, joints, frozenset(first_of), first_of, self._limits.select(joints))
        if len(self._layouts) >= _LAYOUTS:
            self._layouts.clear()
        self._layouts[key] = layout
        return layout


def _wrong_length(message: JointSetpoints, count: int) -> str:
    """Which vector of a message has another length than it has names."""
    for what in ("position", "velocity", "acceleration"):
        size = getattr(message, what).size
        if size != count:
            return f"{what} has {size} numbers for {count} joints"
    raise AssertionError("all lengths are right")


def _not_finite(message: JointSetpoints) -> str:
    """Which number of a message is not finite; an empty text: none."""
    for what in ("position", "velocity", "acceleration"):
        vector = getattr(message, what)
        if not np.isfinite(vector).all():
            place = int(np.flatnonzero(~np.isfinite(vector))[0])
            return f"{what} of joint {message.names[place]!r} is {vector[place]}, not a finite number"
    return ""
