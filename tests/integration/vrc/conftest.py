"""One system for all files of this folder: they run by their names, and the last kills its processes."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import bifrost
from harness.instance import RunningInstance
from harness.system import RosClient
from tests.integration.shared import left_standing
from tests.integration.vrc.vrc_system import go, standing_robot

BALANCING = (
    "stand",
    "stand_manipulate",
    "manipulate",
    "step",
    "step_manipulate",
    "walk",
    "walk_manipulate",
)  # control modes


@pytest.fixture(scope="package")
def system() -> Iterator[RunningInstance]:
    """It runs, as long as the folder's tests."""
    with standing_robot() as running:
        yield running


@pytest.fixture(scope="module")
def ros(system: RunningInstance) -> Iterator[RosClient]:
    """An ordinary ROS 2 client; the robot stands."""
    client = RosClient(system.environment)
    go(client, "stand")
    yield client
    client.close()


@pytest.fixture(autouse=True)
def leaves_it_balancing(request: pytest.FixtureRequest) -> Iterator[None]:
    """Each test leaves the robot on its feet, except those that kill processes, which come last."""
    if "ros" not in request.fixturenames or request.path.stem == "test_when_processes_die":
        yield
        return
    client: RosClient = request.getfixturevalue("ros")
    with left_standing(lambda: go(client, "stand"), lambda: client.reports[-1].current_control_mode, BALANCING):
        yield


@pytest.fixture
def manipulating(ros: RosClient) -> RosClient:
    """A client before whom the arms are free."""
    go(ros, "stand")
    go(ros, "stand_manipulate")
    return ros


@pytest.fixture(scope="package")
def node(system: RunningInstance) -> bifrost.Node:
    """A node in the system's Bifrost network."""
    return system.node(f"{system.instance.name}_test")
