"""Setting the computer's clock stops no robot: durations are measured by a monotonic clock."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from harness.places import REPOSITORY

WALL = {"time", "time_ns", "now", "utcnow", "today", "localtime", "gmtime"}
DATES = {
    "services/bag_recorder/clock.py": "dates of recordings",
    "services/bag_recorder/bag_store.py": "names and ages of recordings",
    "services/foxglove_bridge/scene.py": "stamps of what is shown, as those of what is recorded",
    "services/link_robot/observer.py": "how long ago the middleware stamped a picture",
    "services/operator_station/tabs/status.py": "a page's time of day",
    "valor/bags/recordings.py": "ages of recordings",
    "valor/bags/retention.py": "ages of recordings",
    "valor/ros/lateness.py": "how long ago the middleware stamped a message",
    "valor/ros/node.py": "stamps of lines of the log",
    "valor/valorctl/recordings/bag_summary.py": "ages of recordings",
    "valor/valorctl/recordings/recording_report.py": "ages of recordings",
    "valor/valorctl/status/observation_verbs.py": "since when logs are shown",
    "thesis/experiments/experiment.py": "when an experiment was made",
    "valor/valorctl/hosts/orders.py": "how far hosts' wall clocks are apart",
    "valor/valorctl/hosts/remote.py": "how far hosts' wall clocks are apart",
    "valor/valorctl/instance/running.py": "how long a process runs, whose begin the kernel gives so",
    "valor/valorctl/status/status_view.py": "since when a behavior lasts",
    "valor/valorctl/status/status.py": "since when a behavior lasts",
}
"""Where dates are meant, and nothing that moves a robot or determines which process is alive."""


def wall_clocks(source: str) -> Iterator[str]:
    """Calls that look at the wall's clock."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in WALL:
            owner = node.func.value
            name = owner.id if isinstance(owner, ast.Name) else owner.attr if isinstance(owner, ast.Attribute) else ""
            if name in ("time", "datetime", "date", "dt"):
                yield f"{name}.{node.func.attr}"
        if isinstance(node, ast.Attribute) and node.attr == "CLOCK_REALTIME":
            yield node.attr


def product() -> Iterator[Path]:
    """Every module, each once: packages of services are linked into ``valor``."""
    for folder in ("bifrost", "services", "thesis", "valor"):
        for file in (REPOSITORY / folder).rglob("*.py"):
            if not any(parent.is_symlink() for parent in file.parents):
                yield file


def test_durations_are_measured_by_a_monotonic_clock() -> None:
    found = {str(file.relative_to(REPOSITORY)) for file in product() if list(wall_clocks(file.read_text()))}
    assert found == set(DATES)


@pytest.mark.parametrize("call", ["time.time()", "datetime.now()", "datetime.datetime.utcnow()", "time.time_ns()"])
def test_a_look_at_the_wall_is_seen(call: str) -> None:
    assert list(wall_clocks(f"x = 3 + {call}")) and not list(wall_clocks("x = time.monotonic_ns() + perf.time()"))
