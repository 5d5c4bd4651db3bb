"""What came over the fast channel, for the operator's domain: the robot's view and the bags, and how they fare."""

from __future__ import annotations

import logging
from typing import Any

import msgspec
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import String

from valor.common.fetching import FETCH, FILES, PICTURE, Bag
from valor.link.bulk.fetcher import Fetcher
from valor.link.ends import OperatorEnd
from valor.link.errors import LinkError

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
PERIOD = 0.5  # between two looks at how bags fare [s]
_log = logging.getLogger("link_operator")


class Things:
    """From the loop's thread."""

    def __init__(self, node: Node, end: OperatorEnd, fetcher: Fetcher) -> None:
        self._node, self._end, self._fetcher = node, end, fetcher
        self._pictures = node.create_publisher(CompressedImage, PICTURE, LATCHED)
        self._files = node.create_publisher(DiagnosticArray, FILES, LATCHED)
        node.create_subscription(String, FETCH, self._fetch, 10)
        self._shown: Any = None
        self._refused: dict[str, str] = {}
        self._told: list[DiagnosticStatus] | None = None
        self._due = 0.0

    def turn(self, now: float) -> None:
        """Tell what is new; ``now``: monotonic [s]."""
        if self._fetcher.picture is not None and self._fetcher.picture is not self._shown:
            self._shown = self._fetcher.picture
            described, content = self._shown
            message = CompressedImage(format=described.form, data=content)
            message.header.frame_id = described.name
            message.header.stamp = self._stamp(now)
            self._pictures.publish(message)
        if now >= self._due:
            self._due = now + PERIOD
            if (told := self._statuses()) != self._told:
                self._told = told
                message = DiagnosticArray(status=told)
                message.header.stamp = self._node.get_clock().now().to_msg()
                self._files.publish(message)

    def age(self, now: float) -> float:
        """Of the picture that is shown, at most [s]; inf: there is none, or nothing is known."""
        return self._end.other.age(self._shown[0].clock / 1e3, now) if self._shown else float("inf")

    def _stamp(self, now: float) -> Time:
        """When it was so, by the node's clock."""
        age, shows = self.age(now), self._node.get_clock().now().nanoseconds
        seconds, rest = divmod(max(0, shows - round(1e9 * age)) if age < 3600.0 else 0, 10**9)
        return Time(sec=seconds, nanosec=rest)

    def values(self, now: float) -> dict[str, str]:
        """For ``/link/status``."""
        age = self.age(now)
        return {"picture_age": f"{age:.3f}"} if age < float("inf") else {}

    def _fetch(self, message: String) -> None:
        try:
            self._fetcher.errands.want(message.data)
            self._refused.pop(message.data, None)
        except LinkError as error:
            _log.warning("not fetched: %s", error)
            self._refused = {message.data[:96]: str(error)}
        self._due = 0.0

    def _statuses(self) -> list[DiagnosticStatus]:
        """A bag each: those on the robot, and those that were asked for."""
        errands = self._fetcher.errands.all
        bags = {each.name: each for each in self._bags()}
        found = []
        for name in sorted(bags.keys() | errands.keys() | self._refused.keys()):
            bag, errand = bags.get(name), errands.get(name)
            said = errand.said if errand else "on the robot"
            if name in self._refused:
                said = f"failed: {self._refused[name]}"
            size = errand.size if errand and errand.size >= 0 else bag.size if bag else -1
            values = {"size": str(size), "here": str(errand.here if errand else 0)}
            if bag is not None:
                values |= {"begun": f"{bag.begun:.0f}", "kept": str(bag.kept).lower(), "label": bag.label}
            level = DiagnosticStatus.ERROR if said.startswith("failed") else DiagnosticStatus.OK
            pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
            found.append(DiagnosticStatus(level=level, name=name, message=said, values=pairs))
        return found

    def _bags(self) -> list[Bag]:
        try:
            return msgspec.json.decode(self._fetcher.listing or b"[]", type=list[Bag])
        except msgspec.MsgspecError:
            return []
