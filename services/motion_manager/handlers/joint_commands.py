"""``motion_manager/joint_commands``: commands for the controller ``remote``, accepted completely or rejected."""

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from bifrost import Received
from valor.common.errors import RefusalError
from valor.common.messages import JointCommands
from valor.common.topics import JOINT_COMMANDS
from valor.control.controller import JointCommand
from valor.motion_manager.components import Components
from valor.motion_manager.handlers.handler import Handler, each_joint
from valor.motion_manager.locomotion.remote import NEEDED, RemoteCommand, RemoteController
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.motion_tables import REMOTE, WHOLE_BODY

LONGEST_PERIOD = 0.02  # of a stream [s]
_LAYOUTS = 8  # name lists stored
_VECTORS = ("position", "velocity", "effort", "stiffness", "damping")


class JointCommandsHandler(Handler[JointCommands]):
    """Checks commands, brings positions and velocities within the limits, and forwards them to ``remote``."""

    topic = JOINT_COMMANDS

    def __init__(self, components: Components) -> None:
        super().__init__(components)
        robot, gains = components.robot, components.gains
        self._index, self._limits = robot.index, CommandedLimits.of_joints(robot)
        self._needed = [name for group in NEEDED for name in robot.tables.group(group)]
        self._most = {"stiffness": gains.upper_stiffness, "damping": gains.upper_damping}
        self._layout = lru_cache(_LAYOUTS)(self._make_layout)

    def execute(self, received: Received[JointCommands], now: int) -> None:
        remote, message = self.components.exchange.named(REMOTE), received.message
        if not isinstance(remote, RemoteController):
            listed = f"{{ stand: [{WHOLE_BODY}, {REMOTE}] }}"
            raise RefusalError("controller", f"robot.yaml lists no controller {REMOTE}; expected controllers: {listed}")
        if not 0.0 < message.period <= LONGEST_PERIOD:
            text = f"the period is {message.period:g} s; expected more than 0, at most {LONGEST_PERIOD:g} s"
            raise RefusalError("period", text)
        joints = self._layout(*message.names)
        vectors = np.zeros((len(_VECTORS), len(self._index)))
        vectors[:, joints] = self._numbers(message, joints)
        position, velocity, *others = vectors
        command = JointCommand(self._limits.position_within(position), self._limits.velocity_within(velocity), *others)
        named = np.isin(np.arange(len(self._index)), joints)
        remote.receive(RemoteCommand(message.time, message.period, received.sequence, named, command), now)

    def _make_layout(self, *names: str) -> npt.NDArray[np.intp]:
        """(k,) indices of the joints; raises RefusalError about a wrong name."""
        joints = np.array([self._index[name] for name in each_joint(names, self._index)], dtype=np.intp)
        if missing := [name for name in self._needed if name not in names]:
            text = f"joint {missing[0]!r} is missing; expected all of {', '.join(NEEDED)}: {', '.join(self._needed)}"
            raise RefusalError("names", text)
        return joints

    def _numbers(self, message: JointCommands, joints: npt.NDArray[np.intp]) -> list[npt.NDArray[np.float64]]:
        """Position, velocity, effort, stiffness, damping, (k,) each; raises RefusalError about a wrong one."""
        vectors = [getattr(message, what) for what in _VECTORS]
        for what, vector in zip(_VECTORS, vectors, strict=True):
            if vector.shape != joints.shape:
                raise RefusalError("length", f"{what} has {vector.size} numbers for {joints.size} joints")
            if not np.isfinite(vector).all():
                joint = int(np.argmin(np.isfinite(vector)))
                text = f"{what} of joint {message.names[joint]!r} is {vector[joint]:g}; expected a finite number"
                raise RefusalError("finite", text)
        for what, most in self._most.items():
            vector, limit = getattr(message, what), most[joints]
            if (wrong := (vector < 0.0) | (vector > limit)).any():
                joint = int(wrong.argmax())
                text = f"{what} of joint {message.names[joint]!r} is {vector[joint]:g}; expected 0 to {limit[joint]:g}"
                raise RefusalError("gains", text)
        return vectors
