"""Whether topics on ROS 2 arrive, and how often."""

import time
from collections.abc import Sequence
from functools import partial
from typing import Any

from valor.common.instance import Instance
from valor.ros.definitions import message_type
from valor.ros.topics import suiting
from valor.valorctl.drive.ros_client import RosClient

DISCOVERY = 3.0  # until a publisher is found, at most [s]
WINDOW = 3.0  # in which messages are counted [s]


def rates(instance: Instance, topics: Sequence[str]) -> dict[str, float | None]:
    """Return the rate of each topic, by a relative name, by the wall clock [Hz]; None if there is no publisher."""
    arrived: dict[str, list[float]] = {}

    def note(topic: str, _message: Any) -> None:
        arrived[topic].append(time.monotonic())

    with RosClient(instance, commands=False) as client:
        deadline = time.monotonic() + DISCOVERY
        while time.monotonic() < deadline and len(arrived) < len(topics):
            client.rest()
            for topic in set(topics) - set(arrived):
                if offered := client.node.get_publishers_info_by_topic(topic):
                    arrived[topic] = []
                    qos = suiting([each.qos_profile for each in offered], 1)
                    client.subscribe(message_type(offered[0].topic_type), topic, partial(note, topic), qos)
        deadline = time.monotonic() + WINDOW
        while arrived and time.monotonic() < deadline:
            client.rest()
    return {topic: rate(arrived[topic]) if topic in arrived else None for topic in topics}


def rate(times: Sequence[float]) -> float:
    """Return the rate of messages that arrived at these times [s], 0 with less than two [Hz]."""
    return (len(times) - 1) / (times[-1] - times[0]) if len(times) > 1 else 0.0
