"""Both ends of the link as processes between two ROS domains, a finished bag, and an emulated link between them."""

from __future__ import annotations

import random
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bifrost
from harness.instance import RunningInstance
from harness.places import ROBOTS
from harness.system import RosClient
from harness.waiting import wait_until
from valor.bags.files import BEGINNING
from valor.common import membership
from valor.common.fetching import FETCH, FILES, PICTURE
from valor.common.instance import Instance, Settings
from valor.common.table import checked
from valor.valorctl.ros_domain import daemon_ports, reserve, reserve_for

BAG = "2026-01-01_00-00-00"
ENDS = ("bifrostd", "link_robot", "link_operator")


@dataclass
class Ends:
    """What the operator is told of.

    Attributes:
        beside: a client in the robot's domain.
        operator: one in the operator's.
        content: of the bag.
    """

    running: RunningInstance
    beside: RosClient
    operator: RosClient
    content: bytes
    files: list[Any] = field(default_factory=list)
    told: list[Any] = field(default_factory=list)
    pictures: list[Any] = field(default_factory=list)

    def start(self, name: str) -> None:
        self.running.start(name, env={"BIFROST_OWNERS": str(self.running.instance.owners)})

    def said(self, name: str) -> str:
        """How a bag stands."""
        return str({each.name: each.message for each in self.files[-1].status}.get(name, "")) if self.files else ""

    def here(self, name: str) -> int:
        """How much of a bag has come [B]."""
        values = {each.name: each.values for each in self.files[-1].status}.get(name, ()) if self.files else ()
        return int({pair.key: pair.value for pair in values}.get("here", 0))

    def asked(self, name: str) -> bool:
        """Whether the operator's end has heard that it is wanted."""
        return self.said(name) not in ("", "on the robot")

    def fetch(self, name: str) -> None:
        """Ask for a bag, as often as it takes to be heard."""
        from std_msgs.msg import String

        publisher = self.operator._call(self.operator.node.create_publisher, String, FETCH, 10)
        wait_until(publisher.get_subscription_count, 60.0, "link_operator to listen")

        def asked() -> bool:
            publisher.publish(String(data=name))
            until = time.monotonic() + 3.0
            wait_until(lambda: self.asked(name) or time.monotonic() > until, 30.0, "an answer, or nobody")
            return self.asked(name)

        wait_until(asked, 60.0, f"{name} to be asked for")


@contextmanager
def link_ends(home: Path, size: int, slow_port: int = 0) -> Iterator[Ends]:
    """An instance of nothing but the link, whose robot has a bag of ``size`` [B].

    Args:
        home: of the instance.
        size: of the bag [B].
        slow_port: of what stands between; the fast channel has the next; 0: nothing does.
    """
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from sensor_msgs.msg import CompressedImage

    made = Instance("link_fast", home)
    made.logs.mkdir(parents=True)
    content = BEGINNING + random.Random(1).randbytes(size - len(BEGINNING))
    (made.bags / BAG).mkdir(parents=True)
    (made.bags / BAG / f"{BAG}.mcap").write_bytes(content)
    with reserve_for(made) as reservation, reserve("link_fast_operator", {reservation.domain}) as theirs:
        link = {"domain": theirs.domain, "slow": slow_port, "fast": slow_port and slow_port + 1}
        settings = {"robot": str(ROBOTS / "escher"), "ros_domain_id": reservation.domain,
                    "port_block": reservation.domain, "link": link}  # fmt: skip
        made.settings_file.write_text(checked(Settings, settings).json())
        network = bifrost.Network.create(
            made.network_file, made.keys, ports=daemon_ports(reservation.domain), charter=membership.charter(made)
        )
        instance = RunningInstance(made, network)
        environment = made.environment()
        beside, operator = (
            RosClient(each, joint_states=False)
            for each in (environment, environment | {"ROS_DOMAIN_ID": str(theirs.domain)})
        )
        found = Ends(instance, beside, operator, content)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for kind, topic, take in (
            (DiagnosticArray, FILES, found.files.append),
            (DiagnosticStatus, "link/status", found.told.append),
            (CompressedImage, PICTURE, found.pictures.append),
        ):
            operator._call(operator.node.create_subscription, kind, topic, take, latched)
        try:
            yield found
        finally:
            operator.close()
            beside.close()
            instance.close()
