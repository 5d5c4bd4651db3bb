"""The fast channel between both ends as processes: bags and pictures in windows that nobody has told them of."""

from __future__ import annotations

import random
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest

import bifrost
from harness.instance import RunningInstance
from harness.places import ROBOTS
from harness.system import RosClient
from harness.waiting import wait_until
from valor.bags.files import BEGINNING
from valor.common import membership
from valor.common.fetching import FETCH, FILES, PICTURE
from valor.common.instance import Instance, Settings
from valor.common.linking import robot_ports
from valor.common.table import checked
from valor.link.classes import ALWAYS_ON, HEADERS
from valor.link.emulate import Emulator
from valor.link.emulator import DRC_SLOW, Conditions
from valor.valorctl.ros_domain import daemon_ports, reserve, reserve_for

BAG = "2026-01-01_00-00-00"
SIZE = 20_000_000
# Windows are narrow, so that the bag takes several on any computer.
FAST = Conditions(
    bandwidth=300e6, delay=0.002, loss=0.02, duplication=0.02, reordering=0.02, held=0.02, waiting=4_000_000
)
WINDOWS = [(0.5 + 1.0 * place, 0.8 + 1.0 * place) for place in range(100_000)]


@dataclass
class Operation:
    """Both ends, and what the operator is told."""

    running: RunningInstance
    emulator: Emulator
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


@pytest.fixture(scope="module")
def operation(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Operation]:
    """An instance of nothing but the link, a finished bag, the emulated link, and the operator's domain."""
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from sensor_msgs.msg import CompressedImage

    made = Instance("link_fast", tmp_path_factory.mktemp("home"))
    made.logs.mkdir(parents=True)
    content = BEGINNING + random.Random(1).randbytes(SIZE - len(BEGINNING))
    (made.bags / BAG).mkdir(parents=True)
    (made.bags / BAG / f"{BAG}.mcap").write_bytes(content)
    emulator = Emulator((0, 0), DRC_SLOW, FAST, windows=WINDOWS)
    with reserve_for(made) as reservation, reserve("link_fast_operator", {reservation.domain}) as theirs:
        link = {"domain": theirs.domain, "slow": emulator.listening, "fast": emulator.listening + 1}
        settings = {"robot": str(ROBOTS / "escher"), "ros_domain_id": reservation.domain,
                    "port_block": reservation.domain, "link": link}  # fmt: skip
        made.settings_file.write_text(checked(Settings, settings).json())
        emulator.to = robot_ports(made.settings())
        network = bifrost.Network.create(
            made.network_file, made.keys, ports=daemon_ports(reservation.domain), charter=membership.charter(made)
        )
        instance = RunningInstance(made, network)
        environment = made.environment()
        beside, operator = (
            RosClient(each, joint_states=False)
            for each in (environment, environment | {"ROS_DOMAIN_ID": str(theirs.domain)})
        )
        found = Operation(instance, emulator, beside, operator, content)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for kind, topic, take in (
            (DiagnosticArray, FILES, found.files.append),
            (DiagnosticStatus, "link/status", found.told.append),
            (CompressedImage, PICTURE, found.pictures.append),
        ):
            operator._call(operator.node.create_subscription, kind, topic, take, latched)
        try:
            for name in ("bifrostd", "link_robot", "link_operator"):
                found.start(name)
            yield found
        finally:
            operator.close()
            beside.close()
            instance.close()
            emulator.close()


def test_a_bag_comes_in_windows_while_both_ends_are_killed_and_slow_bytes_stay_in_their_budget(
    operation: Operation,
) -> None:
    name = f"{BAG}.mcap"
    wait_until(lambda: operation.said(name) == "on the robot", 90.0, "the list of bags")
    operation.fetch(name)
    slow, began = sum(line.passed for line in operation.emulator.lines[:2]), time.monotonic()
    wait_until(lambda: operation.here(name) > 0, 120.0, "some of it")
    for end in ("link_operator", "link_robot"):
        before = operation.here(name)
        operation.running.kill(end)
        operation.start(end)
        wait_until(
            lambda before=before: operation.here(name) > before or operation.said(name) == "here",  # type: ignore[misc]
            120.0,
            f"it to go on after {end} was killed",
        )
    wait_until(lambda: operation.said(name) == "here", 300.0, "all of it")
    passed = sum(line.passed for line in operation.emulator.lines[:2]) - slow
    lasted = time.monotonic() - began
    assert passed <= ALWAYS_ON * lasted + 8 * (HEADERS + 450)  # and what was saved up, of three processes
    folder = operation.running.instance.fetched
    assert (folder / name).read_bytes() == operation.content
    assert [each.name for each in folder.iterdir() if each.name != ".wanted.json"] == [name]


def test_a_name_that_leads_elsewhere_or_nowhere_is_told_and_nothing_is_written(operation: Operation) -> None:
    for name, why in (("../instance.json", "expected letters"), ("2020-01-01_00-00-00.mcap", "no finished bag")):
        operation.fetch(name)
        wait_until(lambda name=name, why=why: why in operation.said(name), 120.0, f"{name} to be refused")  # type: ignore[misc]
    folder = operation.running.instance.fetched
    assert not [each for each in folder.rglob("*") if each.suffix == ".json" and each.name != ".wanted.json"]


def test_the_newest_picture_comes_with_its_age(operation: Operation) -> None:
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from sensor_msgs.msg import CompressedImage

    publisher = operation.beside._call(
        operation.beside.node.create_publisher,
        CompressedImage,
        operation.running.settings.link.picture,
        QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT),
    )
    wait_until(publisher.get_subscription_count, 60.0, "link_robot to listen")
    sent: dict[bytes, float] = {}

    def comes() -> bool:
        """Published again, as a camera does: what is sent before all have found each other is lost."""
        data = random.Random(len(sent)).randbytes(40_000)
        message = CompressedImage(format="jpeg", data=data)
        message.header.frame_id = "camera"
        sent[data] = time.monotonic()
        publisher.publish(message)
        until = time.monotonic() + 3.0
        wait_until(lambda: operation.pictures or time.monotonic() > until, 30.0, "a picture, or none")
        return bool(operation.pictures)

    wait_until(comes, 120.0, "a picture")
    picture = operation.pictures[-1]
    assert bytes(picture.data) in sent and (picture.format, picture.header.frame_id) == ("jpeg", "camera")

    def age() -> float:
        values = {pair.key: pair.value for pair in operation.told[-1].values}
        return float(values.get("picture_age", "nan"))

    operation.told.clear()
    wait_until(lambda: operation.told and age() == age(), 60.0, "its age")
    first = age()
    heard = len(operation.told)
    wait_until(lambda: len(operation.told) > heard + 10, 60.0, "it to be told again")
    assert age() > first  # no other has come since
