"""``motion_manager/joint_setpoints``: complete messages are followed or rejected."""

from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from math import isfinite

import numpy as np
import numpy.typing as npt

from bifrost import Received
from valor.common.errors import RefusalError
from valor.common.messages import JointSetpoints
from valor.common.topics import JOINT_SETPOINTS
from valor.motion_manager.components import Components
from valor.motion_manager.handlers.handler import STALE, Handler, each_joint
from valor.motion_manager.hands.hand_goals import SIDES
from valor.motion_manager.joints.joint_reference import Setpoint
from valor.robot.commanded_limits import CommandedLimits

AHEAD = 0.1  # largest time of a set-point's state ahead of robot time [s]
_LAYOUTS = 64  # name lists stored


@dataclass(frozen=True, slots=True)
class Layout:
    """Joints of a list of names."""

    joints: npt.NDArray[np.intp]  # (k,) indices in every joint vector
    first_of: dict[type[StrEnum], str]  # internal FSM that owns some of them → one of its joints, for rejections
    limits: CommandedLimits  # of these joints


class JointSetpointsHandler(Handler[JointSetpoints]):
    """Checks set-points, clamps them to the limits and forwards them to the upper body.

    Their age is robot time, which is the same on all computers. Set-points for a state before this Motion Manager took
    control are stale.
    """

    topic = JOINT_SETPOINTS

    def __init__(self, components: Components) -> None:
        super().__init__(components)
        robot = components.robot
        self._index, self._limits = robot.index, CommandedLimits.of_joints(robot)
        self._arms = [set(robot.group_indices(f"{side}_arm").tolist()) for side in SIDES]
        self._layout = lru_cache(_LAYOUTS)(self._make_layout)

    def execute(self, received: Received[JointSetpoints], now: int) -> None:
        message, components = received.message, self.components
        layout = self._layout(*message.names)
        self._check_time(message.time, now)
        _check_vectors(message, layout.joints.size)
        for machine, joint in layout.first_of.items():
            if closed := components.upper_body.closed(machine):
                raise RefusalError(
                    "closed",
                    f"joint {joint!r} is closed to set-points in behavior {components.fsm.behavior}: {closed}",
                )
        if frozen := components.upper_body.frozen_limb(layout.joints, now * 1e-9):
            raise RefusalError("frozen", frozen)
        for side, arm in enumerate(self._arms):
            if components.hand_goals.moves(side, now * 1e-9) and (arm & set(layout.joints.tolist())):
                raise RefusalError("hand_goal", f"the {SIDES[side]} arm follows a hand goal")
        limits = layout.limits
        setpoint = Setpoint(
            layout.joints,
            position=limits.position_within(message.position),
            velocity=limits.velocity_within(message.velocity),
            acceleration=limits.acceleration_within(message.acceleration),
            time=message.time * 1e-9,
        )
        components.upper_body.follow(layout.first_of, setpoint, now * 1e-9, received.sequence)
        wrong = components.upper_body.inconsistent[layout.joints]
        if wrong.any():
            joint = message.names[int(np.argmax(wrong))]
            reason = f"the acceleration of joint {joint!r} is not what its velocity does; it is not fed forward"
            components.rejections.add(self.topic.name, received.origin, "acceleration", reason)

    def _check_time(self, time: int, now: int) -> None:
        age = (now - time) * 1e-9
        if age > STALE:
            raise RefusalError("stale", f"stale: made for a state {age:.3f} s old; expected at most {STALE} s")
        if time < self.components.authority.since:
            raise RefusalError("taken_over", "stale: made before this Motion Manager took the robot over")
        if age < -AHEAD:
            raise RefusalError("ahead", f"made for a state {-age:.3f} s ahead of robot time; another world's?")

    def _make_layout(self, *names: str) -> Layout:
        owners = self.components.upper_body.owners
        if not names:
            raise RefusalError("names", "names no joint")
        first_of: dict[type[StrEnum], str] = {}
        for name in each_joint(names, self._index):
            if name not in owners:
                raise RefusalError("names", f"joint {name!r} is in no group that moves; it is held at nominal")
            first_of.setdefault(owners[name], name)
        joints = np.array([self._index[name] for name in names], dtype=np.intp)
        return Layout(joints, first_of, self._limits.select(joints))


def _check_vectors(message: JointSetpoints, count: int) -> None:
    """Raise ``RefusalError`` unless all vectors have ``count`` finite numbers."""
    position, velocity, acceleration = message.position, message.velocity, message.acceleration
    # A sum of squares is finite only if its terms are: most messages need no further check.
    if len(position) == len(velocity) == len(acceleration) == count and isfinite(
        position.dot(position) + velocity.dot(velocity) + acceleration.dot(acceleration)
    ):
        return
    for what, vector in (("position", position), ("velocity", velocity), ("acceleration", acceleration)):
        if vector.size != count:
            raise RefusalError("length", f"{what} has {vector.size} numbers for {count} joints")
        for name, number in zip(message.names, vector.tolist(), strict=True):
            if not isfinite(number):
                raise RefusalError("finite", f"{what} of joint {name!r} is {number}, not a finite number")
