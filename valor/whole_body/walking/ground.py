"""The ground ahead of feet that do not see it: a plane through where they stood last.

The plane is the weighed least-squares fit to the last footholds, the newest counting most, and its slope is drawn to
zero a little (ridge regression): a few footholds within a metre tell bumps from slope badly. Where feet stood tells
more than how their soles lie, for a sole lies as the few centimetres under its edges do.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from valor.common.arrays import FloatArray

FOOTHOLDS = 5  # remembered
FADING = 0.8  # weight of a foothold, to that of the one after it
LEVELNESS = 0.03  # weight of the belief that the ground is level [m²]
STEEPEST = 0.12  # slope that is believed, along either axis


class GroundPlane:
    """Height of the ground over odom's x and y, as the footholds tell."""

    def __init__(self) -> None:
        """Level, at height 0, until a foot stands."""
        self._footholds: deque[FloatArray] = deque(maxlen=FOOTHOLDS)
        self._middle = np.zeros(3)
        self._slope = np.zeros(2)

    def forget(self) -> None:
        """What was felt is of no meaning any more."""
        self._footholds.clear()
        self._middle, self._slope = np.zeros(3), np.zeros(2)

    def stand(self, soles: tuple[FloatArray, FloatArray], moved: bool) -> None:
        """Both feet stand.

        Args:
            soles: (3,) positions in odom [m], of the foot that has stood longer and of the one that landed last.
            moved: whether the latter has made a step since the last call; the former may have settled meanwhile.
        """
        feet = self._footholds
        if len(feet) < 2:
            feet.clear()
            feet.extend(soles)
        elif moved:
            feet[-1] = soles[0]
            feet.append(soles[1])
        else:
            feet[-2], feet[-1] = soles
        self._fit()

    def height(self, x: float, y: float) -> float:
        """Of the ground in odom [m]."""
        mx, my, mz = self._middle.tolist()
        sx, sy = self._slope.tolist()
        return float(mz + sx * (x - mx) + sy * (y - my))

    def _fit(self) -> None:
        places = np.array(self._footholds)
        weights = FADING ** np.arange(len(places) - 1.0, -1.0, -1.0)
        self._middle = weights @ places / weights.sum()
        places -= self._middle
        ways, rises = places[:, :2], places[:, 2]
        normal = ways.T @ (weights[:, None] * ways) + LEVELNESS * np.eye(2)
        self._slope = np.clip(np.linalg.solve(normal, ways.T @ (weights * rises)), -STEEPEST, STEEPEST)
