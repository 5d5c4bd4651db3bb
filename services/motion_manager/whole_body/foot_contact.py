"""Does a foot stand? How probably, from what it feels and from whether it moves as standing feet do."""

from __future__ import annotations

from math import atan2

from valor_common.robot import Foot

Vector = tuple[float, float, float]
Rows = list[list[float]]

SURPRISE_TIME = 0.02  # over which surprise is averaged, so that noise alone is none [s]
LEAST = 0.05  # probability of a foot in contact: it never says nothing at all


class FootContact:
    """One foot in one period, in odom's axes: floats, for there are too few numbers for NumPy.

    Attributes:
        touching: whether the foot carries weight, with hysteresis.
        landed: whether it has begun to in this period.
        probability: that it stands still, 0 to 1.
        force: vertical [N].
        cop: (3,) centre of pressure from the sole's origin [m].
        rolled: (3,) how far the sole's origin has moved in this period while the centre of pressure stood still [m].
        yaw: of the sole [rad].
    """

    def __init__(self, foot: Foot, contact_on: float, contact_off: float, settling: float, gate: float) -> None:
        """In the air.

        Args:
            foot: its sole.
            contact_on: vertical force from which on it surely carries weight [N].
            contact_off: until which it surely does not [N].
            settling: how long a foot takes to come to rest [s].
            gate: squared surprise (standard deviations), averaged, that a standing foot may give.
        """
        self._on, self._off, self._settling, self._gate = contact_on, contact_off, settling, gate
        self._heel, self._toe, self._half_width = foot.heel, foot.toe, foot.half_width
        self._rows: Rows = []
        self.lift()

    def lift(self) -> None:
        """Forget everything: in the air."""
        self.touching = self.landed = False
        self.probability = self.force = self.yaw = self._stood = self._surprise = 0.0
        self.cop = self.rolled = (0.0, 0.0, 0.0)

    def update(self, rows: Rows, wrench: list[float], surprise: float, dt: float) -> None:
        """A period.

        Args:
            rows: (3, 3) of the sole in odom.
            wrench: (6,) at the sole, in sole [N, N·m].
            surprise: how far its leg's last measurement was from what was expected, squared, in standard deviations.
            dt: since the last period [s].
        """
        (a, b, _), (d, e, _), (g, h, i) = rows
        fx, fy, fz, tx, ty, _ = wrench
        self.force = force = g * fx + h * fy + i * fz
        self.yaw = atan2(d, a)
        before = self.touching
        self.touching = touching = force >= (self._off if before else self._on)
        self.landed = touching and not before
        x = y = 0.0
        if fz > self._off:
            x = min(max(-ty / fz, self._heel), self._toe)
            y = min(max(tx / fz, -self._half_width), self._half_width)
        self.cop = (a * x + b * y, d * x + e * y, g * x + h * y)
        if not touching:
            self.probability = self._stood = self._surprise = 0.0
            return
        if before:
            self._stood += dt
            (pa, pb, _), (pd, pe, _), (pg, ph, _) = self._rows
            self.rolled = (
                (pa - a) * x + (pb - b) * y,
                (pd - d) * x + (pe - e) * y,
                (pg - g) * x + (ph - h) * y,
            )
        self._rows = rows
        loaded = min(1.0, (force - self._off) / (self._on - self._off))
        self._surprise += (surprise - self._surprise) * min(1.0, dt / SURPRISE_TIME)
        still = min(1.0, self._gate / max(self._surprise, 1e-9)) ** 2
        settled = min(1.0, self._stood / self._settling)
        self.probability = max(LEAST, loaded * settled * still)
