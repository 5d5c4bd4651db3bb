"""The fast channel of the link, from the operator's side: which bags the robot has, and having them."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from valor.common.errors import ConfigurationError, RefusalError
from valor.common.fetching import FETCH, FILES
from valor.common.instance import Instance
from valor.common.linking import behind
from valor.link.bulk.wire import checked_name

HEARD = 10.0  # until link_operator tells of bags [s]
AGAIN = 2.0  # until a name that was not heard is said again [s]
ON_THE_ROBOT = "on the robot"


@dataclass(frozen=True)
class Row:
    """A bag, as link_operator tells of it.

    Attributes:
        size: [B]; −1: not known.
        here: how much has come [B].
        begun: the robot's wall clock [s]; 0: not known.
    """

    name: str
    said: str
    size: int
    here: int
    begun: float
    label: str
    kept: bool

    def as_json(self) -> dict[str, Any]:
        """The object of ``link bags --json``."""
        return asdict(self)

    @classmethod
    def of(cls, status: Any) -> Row:
        """Of a ``diagnostic_msgs/DiagnosticStatus``."""
        values = {pair.key: pair.value for pair in status.values}
        return cls(
            status.name, status.message, int(values.get("size", -1)), int(values.get("here", 0)),
            float(values.get("begun", 0.0)), values.get("label", ""), values.get("kept") == "true",
        )  # fmt: skip


class Listener:
    """Hears of bags in the operator's ROS domain."""

    def __init__(self, instance: Instance, check: Callable[[], None]) -> None:
        """Join.

        Raises:
            ConfigurationError: this computer is not the operator's, behind a link.
        """
        settings = instance.settings()
        if not behind(settings):
            raise ConfigurationError("this computer has no operator's end of a link: `valorctl up --link DOMAIN`")
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.qos import DurabilityPolicy, QoSProfile

        from valor.valorctl.ros_client import RosClient

        self._rows: list[Row] | None = None
        self.ros = RosClient(instance, check, domain=settings.link.domain)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.ros.subscribe(DiagnosticArray, FILES, self._hear, latched)

    def _hear(self, message: Any) -> None:
        self._rows = [Row.of(status) for status in message.status]

    def rows(self) -> list[Row]:
        """What is known now.

        Raises:
            ValorError: link_operator is silent.
        """
        self.ros.wait(lambda: self._rows is not None, HEARD, "link_operator does not tell of bags")
        return self._rows or []

    def row(self, name: str) -> Row | None:
        """Of one bag; None: nobody knows it."""
        return next((row for row in self._rows or () if row.name == name), None)

    def fetch(self, name: str, tell: Callable[[Row], None]) -> None:
        """Have a bag fetched, and wait until it is here, however long that takes.

        Raises:
            ValorError: it will not come; says why.
        """
        from std_msgs.msg import String

        checked_name(name)
        self.rows()
        publisher = self.ros.publisher(String, FETCH, 1)
        before = self.row(name)
        ended = before is not None and _ended(before)
        said = 0.0
        while True:
            row = self.row(name)
            if row is not None and ended and row != before:
                ended = False  # of an earlier time: it is another one now
            if row is None or row.said == ON_THE_ROBOT or ended:
                if time.monotonic() - said > AGAIN:
                    said = time.monotonic()
                    publisher.publish(String(data=name))
            else:
                tell(row)
                if _ended(row):
                    break
            self.ros.rest()
        if row.said != "here":
            raise RefusalError(name, row.said.removeprefix("failed: "))


def _ended(row: Row) -> bool:
    return row.said == "here" or row.said.startswith("failed")


def fetched(instance: Instance, name: str) -> Path:
    """Where a bag is when it is here."""
    return instance.fetched / name
