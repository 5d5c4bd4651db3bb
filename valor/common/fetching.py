"""Bags that the operator fetches over the link: what both ends and `valorctl` say of them."""

from __future__ import annotations

from msgspec import Struct

FILES = "link/files"  # diagnostic_msgs/DiagnosticArray, latched: a status a bag
FETCH = "link/fetch"  # std_msgs/String: the name of one to fetch
PICTURE = "link/picture/compressed"  # sensor_msgs/CompressedImage: the robot's view, as it came over the link


class Bag(Struct, frozen=True):
    """A finished piece of a recording, on the robot.

    Attributes:
        begun: wall clock of the robot [s].
        label: what it was saved for; empty: it holds everything.
    """

    name: str
    size: int
    begun: float
    kept: bool
    label: str
