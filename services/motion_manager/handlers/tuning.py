"""``motion_manager/joint_gains`` and ``motion_manager/balance_weights``: accepted or rejected completely.

Values are clamped to the limits of robot.yaml and reached gradually. They hold while the robot balances; Stand Prep
restores the values of robot.yaml.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from bifrost import Float64Array, Received
from valor.common.errors import RefusalError
from valor.common.messages import BalanceWeights, JointGains
from valor.common.topics import BALANCE_WEIGHTS, JOINT_GAINS
from valor.motion_manager.behavior_fsm import BehaviorFsm
from valor.motion_manager.handlers.handler import Handler
from valor.whole_body.tasks import WEIGHTS

KIND = "tuning"  # of all rejections


class JointGainsHandler(Handler[JointGains]):
    """Forwards gains to ``JointGains``."""

    topic = JOINT_GAINS

    def execute(self, received: Received[JointGains], now: int) -> None:
        message, gains = received.message, self.components.gains
        joints = _indices(self.components.fsm, message.names, self.components.robot.index, "joint")
        _check_numbers(message.names, stiffness=message.stiffness, damping=message.damping)
        if frozen := self.components.upper_body.frozen_limb(joints, now * 1e-9):
            raise RefusalError(KIND, frozen)
        for name, joint in zip(message.names, joints.tolist(), strict=True):
            if not gains.impedance[joint]:
                raise RefusalError(KIND, f"joint {name!r} is not driven by impedance: it has no gains to change")
        gains.request(
            joints,
            np.clip(message.stiffness, gains.lower_stiffness[joints], gains.upper_stiffness[joints]),
            np.clip(message.damping, gains.lower_damping[joints], gains.upper_damping[joints]),
        )


class BalanceWeightsHandler(Handler[BalanceWeights]):
    """Forwards weights to the tasks of the Whole-Body Controller."""

    topic = BALANCE_WEIGHTS

    def execute(self, received: Received[BalanceWeights], now: int) -> None:
        message, weights = received.message, self.components.whole_body.weights
        tasks = {task: i for i, task in enumerate(WEIGHTS)}
        indices = _indices(self.components.fsm, message.names, tasks, "task")
        _check_numbers(message.names, weights=message.weights)
        requested = weights.requested.copy()
        requested[indices] = np.clip(message.weights, weights.lower[indices], weights.upper[indices])
        weights.requested = requested


def _indices(fsm: BehaviorFsm, names: Sequence[str], known: Mapping[str, int], what: str) -> npt.NDArray[np.intp]:
    """Indices of names; raises ``RefusalError`` if the robot does not balance, or a name is unknown or repeated."""
    if not fsm.behavior.operational:
        raise RefusalError(KIND, f"accepted while the robot balances; it is in behavior {fsm.behavior}")
    if not names:
        raise RefusalError(KIND, f"names no {what}")
    for i, name in enumerate(names):
        if name not in known:
            listed = f"; expected {', '.join(known)}" if len(known) < 10 else ""
            raise RefusalError(KIND, f"unknown {what} {name[:64]!r}{listed}")
        if name in names[:i]:
            raise RefusalError(KIND, f"{what} {name!r} is named twice")
    return np.array([known[name] for name in names], dtype=np.intp)


def _check_numbers(names: Sequence[str], **vectors: Float64Array) -> None:
    """Raise ``RefusalError`` unless vectors have a finite number ≥ 0 for each name."""
    for what, vector in vectors.items():
        if vector.shape != (len(names),):
            raise RefusalError(KIND, f"{what} has {vector.size} numbers for {len(names)} names")
        for name, value in zip(names, vector.tolist(), strict=True):
            if not 0.0 <= value < np.inf:
                raise RefusalError(
                    KIND, f"{what} of {name!r} is {value:g}; expected a finite number that is not negative"
                )
