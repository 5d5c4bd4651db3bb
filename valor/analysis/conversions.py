"""What converting messages costs at most (thesis 5.2.2): a segment's latency less what its transport takes alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from valor.analysis.pathways import Latencies, Segment
from valor.common.arrays import FloatArray

Transport = Literal["ros", "bifrost"]

ORIGINS: Mapping[str, Transport] = {
    "Reference → VEC": "ros",
    "VEC → MSetpoint": "bifrost",  # a Proprioceptor comes to the VRC, and its set-points leave
    "Prop. → JS": "bifrost",
    "Mode change cmd.": "ros",
    "Mode change reported": "bifrost",
}
"""By what the message comes from which a segment of the VRC begins."""


@dataclass(frozen=True)
class Conversion:
    """A segment, and the floor of the transport that it begins with.

    Attributes:
        segment: its latencies.
        transport: by which its first message comes.
        floor: (m,) what a double takes over that transport between two processes, meanwhile [s].
    """

    segment: Segment
    transport: Transport
    floor: FloatArray

    @property
    def least(self) -> float:
        """What the transport takes at least [s]: less than any mean, which on a busy computer is of waiting."""
        return float(self.floor.min())

    @property
    def mean(self) -> float:
        """At most, by the mean of the segment [s]."""
        return self.segment.mean - self.least

    @property
    def median(self) -> float:
        """At most, by the median of the segment [s], on which a few late messages do not tell."""
        return self.segment.median - self.least


def conversions(latencies: Latencies, floors: Mapping[str, FloatArray]) -> list[Conversion]:
    """Of the VRC's segments.

    Args:
        latencies: of a run.
        floors: by transport, in the same run (m,) [s].
    """
    return [Conversion(latencies[name], transport, floors[transport]) for name, transport in ORIGINS.items()]
