"""``motion_manager/joint_gains`` and ``motion_manager/balance_weights``: taken whole or refused whole.

What is asked for is brought within the limits of robot.yaml and reached gradually. It lasts while somebody balances;
Stand Prep begins with the values of robot.yaml again.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from bifrost import Float64Array, Received
from valor.common.messages import BalanceWeights as BalanceWeightsMessage
from valor.common.messages import JointGains as JointGainsMessage
from valor.common.topics import BALANCE_WEIGHTS, JOINT_GAINS
from valor.motion_manager.handlers.rejections import Rejections
from valor.motion_manager.joints.joint_gains import JointGains
from valor.motion_manager.states.behavior_fsm import BehaviorFsm
from valor.motion_manager.whole_body.tasks.table import WEIGHTS
from valor.motion_manager.whole_body.tasks.weights import TaskWeights
from valor.robot.description import RobotDescription


class RefusalError(Exception):
    """A message that is not obeyed, and why."""


class TuningHandler:
    """Checks gains and weights and hands them to those who use them."""

    def __init__(
        self,
        robot: RobotDescription,
        fsm: BehaviorFsm,
        gains: JointGains,
        weights: TaskWeights,
        rejections: Rejections,
    ) -> None:
        self._index = robot.index
        self._fsm = fsm
        self._gains = gains
        self._weights = weights
        self._rejections = rejections

    def handle_gains(self, received: Received[JointGainsMessage]) -> bool:
        """Obey or refuse; returns whether it is obeyed."""
        message, gains = received.message, self._gains
        try:
            joints = self._places(message.names, self._index, "joint")
            _check_numbers(message.names, stiffness=message.stiffness, damping=message.damping)
            for name, joint in zip(message.names, joints.tolist(), strict=True):
                if not gains.impedance[joint]:
                    raise RefusalError(f"joint {name!r} is not driven by impedance: it has no gains to change")
        except RefusalError as refusal:
            self._rejections.add(JOINT_GAINS.name, received.origin, "gains", str(refusal))
            return False
        gains.ask(
            joints,
            np.clip(message.stiffness, gains.lower_stiffness[joints], gains.upper_stiffness[joints]),
            np.clip(message.damping, gains.lower_damping[joints], gains.upper_damping[joints]),
        )
        return True

    def handle_weights(self, received: Received[BalanceWeightsMessage]) -> bool:
        """Obey or refuse; returns whether it is obeyed."""
        message, weights = received.message, self._weights
        try:
            places = self._places(message.names, {task: i for i, task in enumerate(WEIGHTS)}, "task")
            _check_numbers(message.names, weights=message.weights)
        except RefusalError as refusal:
            self._rejections.add(BALANCE_WEIGHTS.name, received.origin, "weights", str(refusal))
            return False
        asked = weights.asked.copy()
        asked[places] = np.clip(message.weights, weights.lower[places], weights.upper[places])
        weights.ask(asked)
        return True

    def _places(self, names: Sequence[str], known: dict[str, int], what: str) -> npt.NDArray[np.intp]:
        """Where the named ones stand.

        Raises:
            RefusalError: nobody balances, or a name is unknown or stands twice.
        """
        if not self._fsm.behavior.operational:
            raise RefusalError(f"obeyed while the robot balances; it is in behavior {self._fsm.behavior}")
        if not names:
            raise RefusalError(f"names no {what}")
        for i, name in enumerate(names):
            if name not in known:
                listed = f"; expected {', '.join(known)}" if len(known) < 10 else ""
                raise RefusalError(f"unknown {what} {name[:64]!r}{listed}")
            if name in names[:i]:
                raise RefusalError(f"{what} {name!r} is named twice")
        return np.array([known[name] for name in names], dtype=np.intp)


def _check_numbers(names: Sequence[str], **vectors: Float64Array) -> None:
    """As many as names, finite, not negative.

    Raises:
        RefusalError: they are not.
    """
    for what, vector in vectors.items():
        if vector.shape != (len(names),):
            raise RefusalError(f"{what} has {vector.size} numbers for {len(names)} names")
        for name, value in zip(names, vector.tolist(), strict=True):
            if not 0.0 <= value < np.inf:
                raise RefusalError(f"{what} of {name!r} is {value:g}; expected a finite number that is not negative")
