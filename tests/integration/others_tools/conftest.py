"""One robot for all files of this folder, with a camera, and Foxglove may look on.

The last file takes it down and reads its bag.
"""

from __future__ import annotations

import shutil
import socket
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from harness.system import RosClient, System, running
from tests.integration.others_tools.viewer import Viewer


@pytest.fixture(scope="package")
def port() -> int:
    """That Foxglove finds the robot at."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        free: int = probe.getsockname()[1]
        return free


@pytest.fixture(scope="package")
def system(port: int) -> Iterator[System]:
    """It stands."""
    pytest.importorskip("foxglove", reason="the extra foxglove is not installed")
    home = Path(tempfile.mkdtemp(prefix="valor-"))
    with running(
        "tools", home, "--foxglove-at", str(port), "--camera", "--bag-without", "/camera/*", "--world", "stairs"
    ) as system:
        yield system
    shutil.rmtree(home, ignore_errors=True)


@pytest.fixture
def ros(system: System) -> Iterator[RosClient]:
    """An ordinary ROS 2 client."""
    client = RosClient(system.join())
    yield client
    client.close()


@pytest.fixture
def viewer(system: System, port: int) -> Iterator[Viewer]:
    """Somebody who looks on."""
    with Viewer(port) as looking:
        yield looking
