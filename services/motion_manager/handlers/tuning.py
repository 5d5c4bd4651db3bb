"""``motion_manager/joint_gains`` and ``motion_manager/balance_weights``: taken whole or refused whole.

What is asked for is brought within the limits of robot.yaml and reached gradually. It lasts while somebody balances;
Stand Prep begins with the values of robot.yaml again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Self

import numpy as np
import numpy.typing as npt

from bifrost import Float64Array, Received
from valor.common.errors import RefusalError
from valor.common.messages import BalanceWeights as BalanceWeightsMessage
from valor.common.messages import JointGains as JointGainsMessage
from valor.common.topics import BALANCE_WEIGHTS, JOINT_GAINS
from valor.motion_manager.handlers.handler import Handler
from valor.motion_manager.handlers.rejections import Rejections
from valor.motion_manager.joints.joint_gains import JointGains
from valor.motion_manager.parts import Parts
from valor.motion_manager.states.behavior_fsm import BehaviorFsm
from valor.robot.description import RobotDescription
from valor.whole_body.tasks.table import WEIGHTS
from valor.whole_body.tasks.weights import TaskWeights

KIND = "tuning"  # of every refusal


class JointGainsHandler(Handler[JointGainsMessage]):
    """Hands gains to those who use them."""

    topic = JOINT_GAINS

    def __init__(self, robot: RobotDescription, fsm: BehaviorFsm, gains: JointGains, rejections: Rejections) -> None:
        super().__init__(rejections)
        self._index = robot.index
        self._fsm = fsm
        self._gains = gains

    @classmethod
    def of(cls, parts: Parts) -> Self:
        """The one of a Motion Manager."""
        return cls(parts.robot, parts.fsm, parts.gains, parts.rejections)

    def obey(self, received: Received[JointGainsMessage], now: int) -> None:
        """Have these gains."""
        message, gains = received.message, self._gains
        joints = _places(self._fsm, message.names, self._index, "joint")
        _check_numbers(message.names, stiffness=message.stiffness, damping=message.damping)
        for name, joint in zip(message.names, joints.tolist(), strict=True):
            if not gains.impedance[joint]:
                raise RefusalError(KIND, f"joint {name!r} is not driven by impedance: it has no gains to change")
        gains.ask(
            joints,
            np.clip(message.stiffness, gains.lower_stiffness[joints], gains.upper_stiffness[joints]),
            np.clip(message.damping, gains.lower_damping[joints], gains.upper_damping[joints]),
        )


class BalanceWeightsHandler(Handler[BalanceWeightsMessage]):
    """Hands weights to those who use them."""

    topic = BALANCE_WEIGHTS

    def __init__(self, fsm: BehaviorFsm, weights: TaskWeights, rejections: Rejections) -> None:
        super().__init__(rejections)
        self._fsm = fsm
        self._weights = weights

    @classmethod
    def of(cls, parts: Parts) -> Self:
        """The one of a Motion Manager."""
        return cls(parts.fsm, parts.controller.weights, parts.rejections)

    def obey(self, received: Received[BalanceWeightsMessage], now: int) -> None:
        """Have these weights."""
        message, weights = received.message, self._weights
        places = _places(self._fsm, message.names, {task: i for i, task in enumerate(WEIGHTS)}, "task")
        _check_numbers(message.names, weights=message.weights)
        asked = weights.asked.copy()
        asked[places] = np.clip(message.weights, weights.lower[places], weights.upper[places])
        weights.ask(asked)


def _places(fsm: BehaviorFsm, names: Sequence[str], known: Mapping[str, int], what: str) -> npt.NDArray[np.intp]:
    """Where the named ones stand.

    Raises:
        RefusalError: nobody balances, or a name is unknown or stands twice.
    """
    if not fsm.behavior.operational:
        raise RefusalError(KIND, f"obeyed while the robot balances; it is in behavior {fsm.behavior}")
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
    """As many as names, finite, not negative.

    Raises:
        RefusalError: they are not.
    """
    for what, vector in vectors.items():
        if vector.shape != (len(names),):
            raise RefusalError(KIND, f"{what} has {vector.size} numbers for {len(names)} names")
        for name, value in zip(names, vector.tolist(), strict=True):
            if not 0.0 <= value < np.inf:
                raise RefusalError(
                    KIND, f"{what} of {name!r} is {value:g}; expected a finite number that is not negative"
                )
