"""``remote``: a balance controller outside the Motion Manager, whose joint commands arrive over Bifrost.

The age of a command is robot time: that of the measurement that the controller receives, less that of the measurement
that the command was computed from. It is the same on all computers, stops with a paused simulation, and includes all
delays on the way; a time of sending would hide those before it.

A *stream* is a sequence of commands from one sender without an interruption. A client chooses ``remote`` for the
present stream: a sender that stops and returns is not executed until ``remote`` is chosen again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from valor.common.behaviors import LEGS, Locomotion
from valor.common.errors import RefusalError
from valor.common.topics import JOINT_COMMANDS
from valor.control.controller import Controller, JointCommand, Request
from valor.control.kinematics import Kinematics
from valor.control.state import RobotState
from valor.motion_manager.locomotion.supervision import MUTE
from valor.robot.description import RobotDescription
from valor.robot.limiter import Joints
from valor.robot.motion_tables import REMOTE

LATE = 3  # largest age of a command, periods of its stream
NEEDED = (*LEGS, "torso")  # groups whose joints every command names


@dataclass(frozen=True, slots=True)
class RemoteCommand:
    """A checked command."""

    time: int  # robot time of the measurement that it was computed from [ns]
    period: float  # of its stream [s]
    sequence: int  # the sender's count
    joints: Joints  # (n,) mask of the joints that it names
    command: JointCommand  # (n,) vectors, zero for the other joints


class RemoteController(Controller):
    """Executes the latest command of the stream for which it was chosen, while that is fresh."""

    name = REMOTE
    states = frozenset({Locomotion.STAND})

    def __init__(self, robot: RobotDescription, kinematics: Kinematics) -> None:
        self.joints = np.zeros(len(robot.joints), dtype=bool)
        for group in NEEDED:
            self.joints[robot.group_indices(group)] = True
        self._latest: RemoteCommand | None = None
        self._stream = self._chosen = 0  # numbers of the present stream, and of the one to execute

    @property
    def at_rest(self) -> bool:
        """Both feet stay where they are."""
        return True

    def receive(self, new: RemoteCommand, now: int) -> None:
        """Store a command at robot time ``now`` [ns]. Raises RefusalError: it is late, early or a repetition."""
        last, age, limit = self._latest, 1e-9 * (now - new.time), LATE * new.period
        if age > limit:
            text = f"made for a state {age:.3f} s old; expected at most {limit:.3f} s, {LATE} of its periods"
            raise RefusalError("stale", text)
        if age < -new.period:
            text = f"made for a state {-age:.3f} s ahead of robot time; expected at most a period, {new.period:g} s"
            raise RefusalError("ahead", text)
        if last is not None and last.time <= now + round(1e9 * last.period):  # else robot time went back
            gap = 1e-9 * (new.time - last.time)
            if gap <= 0.0:
                raise RefusalError("repeated", f"made for a state {-gap:.3f} s before the last one's; expected a newer")
            self._stream += gap > MUTE or new.sequence <= last.sequence
        else:
            self._stream += 1
        self._latest = new

    def chosen(self) -> None:
        """Execute the present stream, and no later one."""
        self._chosen = self._stream

    def refusal(self, state: RobotState) -> str:
        """Reason why there is no command to execute; empty if there is one."""
        if (latest := self._latest) is None:
            return f"no command on {JOINT_COMMANDS.name} yet"
        age, limit = 1e-9 * (state.time - latest.time), LATE * latest.period
        if not -limit <= age <= limit:
            return f"the last command is {age:.3f} s old; expected at most {limit:.3f} s, {LATE} of its periods"
        if self._stream != self._chosen:
            return f"the commands on {JOINT_COMMANDS.name} were interrupted; choose {self.name} again"
        return ""

    def begin(self, state: RobotState, last: JointCommand | None) -> None:
        """Start; the sender does not depend on it."""

    def update(self, state: RobotState, request: Request, dt: float) -> JointCommand | None:
        """Return the latest command; None while there is none to execute."""
        if self.refusal(state):
            return None
        assert self._latest is not None
        self.joints = self._latest.joints
        return self._latest.command
