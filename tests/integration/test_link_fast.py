"""The fast channel between both ends as processes: bags and pictures in windows that nobody has told them of."""

from __future__ import annotations

import json
import random
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass

import pytest

from harness.link_ends import BAG, ENDS, Ends, link_ends
from harness.waiting import wait_until
from valor.bags.files import BEGINNING
from valor.common.linking import robot_ports
from valor.link.classes import ALWAYS_ON, HEADERS
from valor.link.emulate import Emulator
from valor.link.emulator import DRC_SLOW, Conditions

SECOND = "2026-01-02_00-00-00"
SIZE = 20_000_000
# Windows are narrow, so that the bag takes several on any computer.
FAST = Conditions(
    bandwidth=300e6, delay=0.002, loss=0.02, duplication=0.02, reordering=0.02, held=0.02, waiting=4_000_000
)
WINDOWS = [(0.5 + 1.0 * place, 0.8 + 1.0 * place) for place in range(100_000)]


@dataclass
class Operation:
    """The ends, and what stands between."""

    ends: Ends
    emulator: Emulator


@pytest.fixture(scope="module")
def operation(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Operation]:
    """All of it, running."""
    emulator = Emulator((0, 0), DRC_SLOW, FAST, windows=WINDOWS)
    try:
        with link_ends(tmp_path_factory.mktemp("home"), SIZE, emulator.listening) as ends:
            emulator.to = robot_ports(ends.running.settings)
            for name in ENDS:
                ends.start(name)
            yield Operation(ends, emulator)
    finally:
        emulator.close()


def test_a_bag_comes_in_windows_while_both_ends_are_killed_and_slow_bytes_stay_in_their_budget(
    operation: Operation,
) -> None:
    ends = operation.ends
    name = f"{BAG}.mcap"
    wait_until(lambda: ends.said(name) == "on the robot", 90.0, "the list of bags")
    ends.fetch(name)
    slow, began = sum(line.passed for line in operation.emulator.lines[:2]), time.monotonic()
    wait_until(lambda: ends.here(name) > 0, 120.0, "some of it")
    for end in ("link_operator", "link_robot"):
        before = ends.here(name)
        ends.running.kill(end)
        ends.start(end)
        wait_until(
            lambda before=before: ends.here(name) > before or ends.said(name) == "here",  # type: ignore[misc]
            120.0,
            f"it to go on after {end} was killed",
        )
    wait_until(lambda: ends.said(name) == "here", 300.0, "all of it")
    passed = sum(line.passed for line in operation.emulator.lines[:2]) - slow
    lasted = time.monotonic() - began
    assert passed <= ALWAYS_ON * lasted + 8 * (HEADERS + 450)  # and what was saved up, of three processes
    folder = ends.running.instance.fetched
    assert (folder / name).read_bytes() == ends.content
    assert [each.name for each in folder.iterdir() if each.name != ".wanted.json"] == [name]


def test_a_name_that_leads_elsewhere_or_nowhere_is_told_and_nothing_is_written(operation: Operation) -> None:
    ends = operation.ends
    for name, why in (("../instance.json", "expected letters"), ("2020-01-01_00-00-00.mcap", "no finished bag")):
        ends.fetch(name)
        wait_until(lambda name=name, why=why: why in ends.said(name), 120.0, f"{name} to be refused")  # type: ignore[misc]
    folder = ends.running.instance.fetched
    assert not [each for each in folder.rglob("*") if each.suffix == ".json" and each.name != ".wanted.json"]


def test_the_newest_picture_comes_with_its_age(operation: Operation) -> None:
    ends = operation.ends
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from sensor_msgs.msg import CompressedImage

    publisher = ends.beside._call(
        ends.beside.node.create_publisher,
        CompressedImage,
        ends.running.settings.link.picture,
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
        wait_until(lambda: ends.pictures or time.monotonic() > until, 30.0, "a picture, or none")
        return bool(ends.pictures)

    wait_until(comes, 120.0, "a picture")
    picture = ends.pictures[-1]
    assert bytes(picture.data) in sent and (picture.format, picture.header.frame_id) == ("jpeg", "camera")

    def age() -> float:
        values = {pair.key: pair.value for pair in ends.told[-1].values}
        return float(values.get("picture_age", "nan"))

    ends.told.clear()
    wait_until(lambda: ends.told and age() == age(), 60.0, "its age")
    first = age()
    heard = len(ends.told)
    wait_until(lambda: len(ends.told) > heard + 10, 60.0, "it to be told again")
    assert age() > first  # no other has come since


def test_valorctl_lists_bags_and_fetches_one(operation: Operation) -> None:
    ends = operation.ends
    made, name = ends.running.instance, f"{SECOND}.mcap"
    content = BEGINNING + random.Random(2).randbytes(100_000)
    (made.bags / SECOND).mkdir()
    (made.bags / SECOND / name).write_bytes(content)
    wait_until(lambda: ends.said(name) == "on the robot", 120.0, "the new bag to be told of")

    def valorctl(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "valor.valorctl", "link", *arguments]
        environment = ends.running.environment
        return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=240.0, check=False)

    listed = valorctl("bags", "--json")
    assert listed.returncode == 0, listed.stderr
    rows = {row["name"]: row for row in json.loads(listed.stdout)}
    assert rows[name]["size"] == len(content) and rows[name]["said"] == "on the robot"
    fetched = valorctl("fetch", name)
    assert fetched.returncode == 0, fetched.stderr
    assert (made.fetched / name).read_bytes() == content and str(made.fetched / name) in fetched.stdout
    unknown = valorctl("fetch", "2019-01-01_00-00-00.mcap")
    assert unknown.returncode and "no finished bag" in unknown.stderr
    elsewhere = valorctl("fetch", "../../instance.json")
    assert elsewhere.returncode and "expected letters" in elsewhere.stderr
