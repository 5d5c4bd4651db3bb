"""Topics of a ROS graph: visibility, and QoS of subscriptions that receive all publishers."""

from collections.abc import Iterable

import yaml
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

_ACTION = "_action"  # in the names of an action's topics
_OF_ACTIONS = ("feedback", "status")  # topics; goals, results and cancellations are services


def shown(name: str, namespace: str = "") -> bool:
    """Return whether a topic is public: no part of its name begins with ``_``, or it is an action's feedback or status.

    In a namespace, topics of other namespaces are hidden; shared ones (``/tf``) have none.
    """
    if namespace and name.count("/") > 1 and not name.startswith(f"/{namespace}/"):
        return False
    *parts, last = name.split("/")
    if parts and parts[-1] == _ACTION and last in _OF_ACTIONS:
        parts.pop()
    return not any(part.startswith("_") for part in (*parts, last))


def suiting(offered: Iterable[QoSProfile], depth: int) -> QoSProfile:
    """Strictest QoS that all publishers offer: reliable and transient-local only if every one is."""
    offered = list(offered)
    reliable = all(qos.reliability == ReliabilityPolicy.RELIABLE for qos in offered)
    latched = all(qos.durability == DurabilityPolicy.TRANSIENT_LOCAL for qos in offered)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def asks_less(new: QoSProfile, old: QoSProfile) -> bool:
    """Return whether a subscription with ``old`` is incompatible with publishers that ``new`` suits."""
    reliability = old.reliability == ReliabilityPolicy.RELIABLE != new.reliability
    durability = old.durability == DurabilityPolicy.TRANSIENT_LOCAL != new.durability
    return bool(reliability or durability)


def qos_text(qos: QoSProfile) -> str:
    """Text of a channel's QoS as in rosbag2, for players."""
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
