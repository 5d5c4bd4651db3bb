"""What is let through to /rosout, and what stands for the rest."""

from __future__ import annotations

import itertools
import subprocess
import sys
from pathlib import Path

import pytest
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile

from harness.places import REPOSITORY, ROBOTS
from harness.waiting import wait_until
from valor.common.instance import Settings
from valor.ros.node import RosSide
from valor.ros.rosout import TOPIC, Sieve


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_the_same_line_passes_seldom_a_kind_more_often_and_no_flood_at_all() -> None:
    clock = Clock()
    sieve = Sieve(clock)
    assert sum(sieve.passes("kind", "text") for _ in range(1000)) == Sieve.ALIKE
    assert sum(sieve.passes("kind", str(i)) for i in range(1000)) == Sieve.OF_A_KIND - Sieve.ALIKE
    assert sum(sieve.passes(str(i), "text") for i in range(1000)) == Sieve.IN_ALL - Sieve.OF_A_KIND
    assert sieve.left_out() == 3000 - Sieve.IN_ALL and sieve.left_out() == 0
    clock.now += Sieve.WINDOW
    assert sieve.passes("kind", "text")


def test_however_long_a_flood_lasts_it_is_bounded_in_lines_and_memory() -> None:
    clock, seconds = Clock(), 20
    sieve = Sieve(clock)
    passed = 0
    for i in itertools.count():
        clock.now = 100.0 + i / 500
        if clock.now >= 100.0 + seconds:
            break
        passed += sieve.passes(i, str(i))
        assert len(sieve._seen) <= 4 * Sieve.IN_ALL
    assert passed <= Sieve.IN_ALL * (seconds + 1)
    assert passed + sieve.left_out() == i


ENDS = """
import logging, sys
from pathlib import Path
from valor.common.errors import ConfigurationError
from valor.common.instance import Settings
from valor.ros.node import RosSide

settings = Settings(robot=Path(sys.argv[1]), ros_domain_id=int(sys.argv[2]))
side = RosSide("ends_early", settings, {}, ())
error = ConfigurationError("robot.yaml: rate: expected a number")
if sys.argv[3] == "closed":
    try:
        try:
            raise error
        except ConfigurationError:
            side.close()
            raise
    except ConfigurationError as told:
        logging.getLogger().error("%s", told)
else:
    logging.getLogger().error("%s", error)
sys.exit(78)
"""


@pytest.mark.parametrize("how", ["closed", "left"])
def test_why_a_process_ends_as_soon_as_it_has_begun_is_heard(ros_domain: int, how: str) -> None:
    side = RosSide("listener", Settings(robot=Path(), ros_domain_id=ros_domain), {}, ())
    heard: list[Log] = []
    qos = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    side.node.create_subscription(Log, TOPIC, heard.append, qos)

    def told() -> list[Log]:
        side.executor.spin_once(timeout_sec=0.05)
        return [each for each in heard if each.name == "ends_early" and "rate: expected a number" in each.msg]

    def start() -> subprocess.Popen[bytes]:
        command = [sys.executable, "-c", ENDS, str(ROBOTS / "escher"), str(ros_domain), how]
        return subprocess.Popen(command, cwd=REPOSITORY)

    process, starts = start(), 1
    try:

        def heard_once() -> bool:
            nonlocal process, starts
            if process.poll() is not None and not told() and starts < 5:
                assert process.returncode == 78
                process, starts = start(), starts + 1  # a busy computer may take longer to find them each other
            return bool(told())

        wait_until(heard_once, 120.0, "the error")
    finally:
        process.kill()
        process.wait()
        side.close()
