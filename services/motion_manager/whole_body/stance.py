"""How the feet stand to each other, held against creep.

What the model has wrong makes the legs push the feet apart, and however little they creep, over an hour it is a split.
The ground tells nothing about it, but the encoders do: each foot is drawn back by half of what they have moved apart
or turned towards each other. Where both feet are together is no business of theirs.
"""

from __future__ import annotations

from math import atan2

from motion_manager.whole_body.state import FloatArray, RobotState


class Stance:
    """Where the left sole is from the right one, horizontally, and how it is turned."""

    def __init__(self, stiffness: float) -> None:
        """Without a stance until ``reset``.

        Args:
            stiffness: acceleration per distance from the stance [1/s²].
        """
        self._half = 0.5 * stiffness
        self._apart = (0.0, 0.0)
        self._turned = 0.0

    def reset(self, state: RobotState) -> None:
        """Keep the stance as it is."""
        cosine, sine, x, y, self._turned = _relative(state)
        self._apart = (cosine * x + sine * y, cosine * y - sine * x)

    def hold(self, state: RobotState, wanted: FloatArray) -> None:
        """Add to what is wanted of the soles.

        Args:
            state: the estimate.
            wanted: (12,) accelerations, left linear, left angular, right linear, right angular; written to.
        """
        cosine, sine, x, y, turned = _relative(state)
        ax, ay = self._apart
        x = self._half * (cosine * ax - sine * ay - x)
        y = self._half * (sine * ax + cosine * ay - y)
        turn = self._half * (self._turned - turned)
        wanted[0] += x
        wanted[1] += y
        wanted[5] += turn
        wanted[6] -= x
        wanted[7] -= y
        wanted[11] -= turn


def _relative(state: RobotState) -> tuple[float, float, float, float, float]:
    """The right foot's heading (cosine, sine), then the left sole from the right one: x, y in odom [m], yaw [rad]."""
    (lx, ly, _), (rx, ry, _) = state.sole_positions_in_odom.tolist()
    left, right = state.sole_rotations_in_odom[:, :2, 0].tolist()
    norm = (right[0] * right[0] + right[1] * right[1]) ** 0.5
    cosine, sine = right[0] / norm, right[1] / norm
    turned = atan2(cosine * left[1] - sine * left[0], cosine * left[0] + sine * left[1])
    return cosine, sine, lx - rx, ly - ry, turned
