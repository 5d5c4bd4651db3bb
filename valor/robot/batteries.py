"""Lithium-polymer batteries of a robot: strings of packs in parallel, their charge, and the draw of its motors.

All packs are alike, and share the current equally. Voltage under load, of r cells in series in each of p strings, with
the open-circuit voltage U of a cell by its charge and its resistance R::

    V = r·U(charge) − I·r·R/p        I = P/V        d(charge)/dt = −I
    P = idle + Σ max(τ·q̇, 0) + copper·Σ τ²/τ_max    of the joints; braking returns nothing
"""

import math
from typing import Annotated

import numpy as np
from msgspec import Meta

from valor.common.arrays import FloatArray
from valor.common.table import NonNegative, Positive, Table, require_order

# Of a lithium-polymer cell at rest, by its share of charge: typical of the chemistry, assumed [V].
_SHARES = (0.0, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 0.9, 1.0)
_VOLTAGES = (3.27, 3.61, 3.69, 3.73, 3.80, 3.87, 4.02, 4.11, 4.20)
LOWEST = 3.0  # of a cell under load; less does it harm [V]

Share = Annotated[float, Meta(ge=0, le=1)]
Count = Annotated[int, Meta(ge=1)]


class Batteries(Table, kw_only=True):
    """Equal packs, and what they supply."""

    location: str = ""  # as in ``sensor_msgs/BatteryState``
    strings: Count  # in parallel
    packs: Count  # of a string, in series
    cells: Count  # of a pack, in series
    capacity: Positive  # of a pack [Ah]
    resistance: Positive  # of a cell and its connections [Ω]
    charge: Share = 1.0  # of the simulated packs at start, share of their capacity
    idle: NonNegative  # drawn by computers and sensors [W]
    copper: NonNegative  # lost in a motor at its effort limit, per newton-metre of that [W/(N·m)]
    low: Share = 0.2  # charge below which it is reported
    critical: Share = 0.1  # charge below which the robot comes to rest

    def __post_init__(self) -> None:
        require_order(self, "critical", "low")

    @property
    def series(self) -> int:
        """Number of cells in series."""
        return self.packs * self.cells

    @property
    def whole(self) -> float:
        """Capacity of all packs together [Ah]."""
        return self.strings * self.capacity

    @property
    def _resistance(self) -> float:
        return self.series * self.resistance / self.strings

    def share(self, voltage: float, current: float) -> float:
        """Share of charge by the voltage under load [V, A]."""
        return float(np.interp((voltage + current * self._resistance) / self.series, _VOLTAGES, _SHARES))

    def voltage(self, share: float, power: float) -> float:
        """Voltage at a share of charge and a power drawn [W]; half the open-circuit one if they cannot give that."""
        rest = self.series * float(np.interp(share, _SHARES, _VOLTAGES))
        return 0.5 * (rest + math.sqrt(max(0.0, rest * rest - 4.0 * self._resistance * power)))

    def power(self, effort: FloatArray, velocity: FloatArray, limit: FloatArray) -> float:
        """Power drawn with (n,) efforts, velocities and effort limits of the joints [W]."""
        return self.idle + float(
            np.maximum(effort * velocity, 0.0).sum() + self.copper * (effort * effort / limit).sum()
        )
