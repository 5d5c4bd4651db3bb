"""Topics of a ROS graph: which of them whoever wants all may have, and the QoS with which to hear all publishers."""

from __future__ import annotations

from collections.abc import Iterable

import yaml
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

_ACTION = "_action"  # in the names of an action's topics
_OF_ACTIONS = ("feedback", "status")  # topics; goals, results and cancellations are services


def shown(name: str, namespace: str = "") -> bool:
    """Whether a topic is for others: no part of its name begins with ``_``, or it is an action's feedback or status.

    For those in a namespace, what stands in another is not; what is everybody's (``/tf``) stands in none.
    """
    if namespace and name.count("/") > 1 and not name.startswith(f"/{namespace}/"):
        return False
    *parts, last = name.split("/")
    if parts and parts[-1] == _ACTION and last in _OF_ACTIONS:
        parts.pop()
    return not any(part.startswith("_") for part in (*parts, last))


def suiting(offered: Iterable[QoSProfile], depth: int) -> QoSProfile:
    """The most that all publishers offer: reliable and transient-local only if every one of them is."""
    offered = list(offered)
    reliable = all(qos.reliability == ReliabilityPolicy.RELIABLE for qos in offered)
    kept = all(qos.durability == DurabilityPolicy.TRANSIENT_LOCAL for qos in offered)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE,
    )


def asks_less(new: QoSProfile, old: QoSProfile) -> bool:
    """Whether a subscription with ``old`` would not hear publishers that ``new`` suits."""
    reliability = old.reliability == ReliabilityPolicy.RELIABLE != new.reliability
    durability = old.durability == DurabilityPolicy.TRANSIENT_LOCAL != new.durability
    return bool(reliability or durability)


def qos_text(qos: QoSProfile) -> str:
    """As rosbag2 writes it into the channel, so that a player offers the like."""
    unlimited = {"sec": 9223372036, "nsec": 854775807}
    profile = {
        "history": "keep_last",
        "depth": 10,
        "reliability": qos.reliability.name.lower(),
        "durability": qos.durability.name.lower(),
        "deadline": unlimited,
        "lifespan": unlimited,
        "liveliness": "automatic",
        "liveliness_lease_duration": unlimited,
        "avoid_ros_namespace_conventions": False,
    }
    return yaml.safe_dump([profile], sort_keys=False)
