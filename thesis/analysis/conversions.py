"""Upper bound of the cost of conversions (thesis 5.2.2): latency of a segment minus that of its transport."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from thesis.analysis.pathways import Latencies, Segment
from valor.common.arrays import FloatArray

Transport = Literal["ros", "bifrost"]

ORIGINS: Mapping[str, Transport] = {
    "Reference → VEC": "ros",
    "VEC → MSetpoint": "bifrost",  # from a Proprioceptor to the set-points
    "Prop. → JS": "bifrost",
    "Mode change cmd.": "ros",
    "Mode change reported": "bifrost",
}
"""Transport of the message at the start of each segment of the VRC."""


@dataclass(frozen=True)
class Conversion:
    """A segment, and the floor of its transport.

    Attributes:
        segment: with its latencies.
        transport: of its first message.
        floor: (m,) latencies of a double over that transport between two processes, in the same system [s].
    """

    segment: Segment
    transport: Transport
    floor: FloatArray

    @property
    def least(self) -> float:
        """Minimum latency of the transport [s]; the mean on a busy computer contains waiting."""
        return float(self.floor.min())

    @property
    def mean(self) -> float:
        """Upper bound from the mean of the segment [s]."""
        return self.segment.mean - self.least

    @property
    def median(self) -> float:
        """Upper bound from the median of the segment, which few late messages do not affect [s]."""
        return self.segment.median - self.least


def conversions(latencies: Latencies, floors: Mapping[str, FloatArray]) -> list[Conversion]:
    """Conversions of the VRC's segments.

    Args:
        latencies: of a run.
        floors: by transport, in the same run (m,) [s].
    """
    return [Conversion(latencies[name], transport, floors[transport]) for name, transport in ORIGINS.items()]
