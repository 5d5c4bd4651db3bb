"""The weights of the tasks, which may be changed while the robot balances: gradually, so that no torque jumps."""

from __future__ import annotations

from collections.abc import Sequence
from math import log

import numpy as np

from valor.common.arrays import FloatArray

DOUBLING_TIME = 0.2  # in which a weight is at most doubled or halved [s]


class TaskWeights:
    """Weights on their way to those asked for.

    Attributes:
        nominal: (k,) of robot.yaml, in the order of ``table.WEIGHTS``.
        values: (k,) in force.
        lower, upper: (k,) between which they may be.
    """

    def __init__(self, nominal: Sequence[float], factor: float, dt: float) -> None:
        """Those of robot.yaml.

        Args:
            nominal: in the order of ``table.WEIGHTS``.
            factor: by which a weight may be greater or smaller than nominal.
            dt: a control period [s].
        """
        self.nominal = np.array(nominal)
        self.lower, self.upper = self.nominal / factor, self.nominal * factor
        self.values = self.nominal.copy()
        self._target = self.nominal
        self._step = float(np.exp(log(2.0) * dt / DOUBLING_TIME))

    def ask(self, values: FloatArray) -> None:
        """Go to (k,) weights within the limits."""
        self._target = values

    @property
    def asked(self) -> FloatArray:
        """(k,) where they go."""
        return self._target

    def reset(self) -> None:
        """Be nominal, at once: for the beginning of balance."""
        self._target = self.nominal
        self.values = self.nominal.copy()

    def advance(self) -> bool:
        """Go one control period; returns whether they changed."""
        if self.values is self._target or np.array_equal(self.values, self._target):
            return False
        self.values = np.clip(self._target, self.values / self._step, self.values * self._step)
        return True
