"""Whether a hand touches something: by the force that its sensor feels, with hysteresis."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.messages import Proprioceptor
from valor.robot.tables import Hands


class HandContacts:
    """Both hands.

    Attributes:
        contacts: (2,) left, right: 1 in contact; a new array whenever it changes.
    """

    def __init__(self, hands: Hands) -> None:
        self._on, self._off = hands.contact_on**2, hands.contact_off**2
        self.contacts: npt.NDArray[np.uint8] = np.zeros(2, dtype=np.uint8)
        self._before = (0, 0)

    @property
    def touching(self) -> bool:
        """Whether any hand is in contact."""
        return any(self._before)

    def update(self, proprioceptor: Proprioceptor) -> None:
        """Take in what the hands' sensors measured."""
        left, right = self._before
        now = (
            self._touches(proprioceptor.left_hand_wrench, left),
            self._touches(proprioceptor.right_hand_wrench, right),
        )
        if now != self._before:
            self._before = now
            self.contacts = np.array(now, dtype=np.uint8)

    def _touches(self, wrench: FloatArray, before: int) -> int:
        x, y, z, *_ = wrench.tolist()
        return int(x * x + y * y + z * z > (self._off if before else self._on))
