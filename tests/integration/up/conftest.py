"""One robot for all files of this folder; each test leaves it standing.

The last file takes it down and reads its bag.
"""

import importlib.util
import shutil
import socket
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

import bifrost
from harness.places import ROBOTS
from harness.system import RosClient, System, running
from harness.waiting import wait_until
from tests.integration.shared import left_standing
from tests.integration.up.viewer import Viewer
from valor.common.instance import Instance
from valor.common.topics import MOTION_STATE

FOXGLOVE = importlib.util.find_spec("foxglove") is not None


@pytest.fixture(scope="package")
def port() -> int:
    """Port of the Foxglove bridge."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        free: int = probe.getsockname()[1]
        return free


@pytest.fixture(scope="package")
def system(port: int) -> Iterator[System]:
    """The system; the robot stands."""
    home = Path(tempfile.mkdtemp(prefix="valor-"))
    shutil.copytree(ROBOTS / "escher", home / "escher")  # with a second controller
    (home / "escher" / "robot.yaml").open("a").write("\ncontrollers: { stand: [whole_body, remote] }\n")
    options = ["--robot", str(home / "escher"), "--view", "--sensors", "lidar,camera", "--world", "stairs"]
    options += ["--bag-without", "/multisense/*", "--bag-without", "/lidar/*"]
    options += ["--foxglove-at", str(port)] if FOXGLOVE else []
    with running("up", home, *options) as system:
        yield system
    shutil.rmtree(home, ignore_errors=True)


@pytest.fixture(scope="package")
def node(system: System) -> Iterator[bifrost.Node]:
    """A node in the system's Bifrost network."""
    instance = Instance(system.name, Path(system.environment["VALOR_HOME"]))
    with bifrost.Node("test", network=bifrost.Network.load(instance.network_file, instance.keys)) as node:
        yield node


@pytest.fixture(autouse=True)
def leaves_it_standing(request: pytest.FixtureRequest) -> Iterator[None]:
    """Each test leaves the robot standing, except those on the bag of a system that is down."""
    if "system" not in request.fixturenames or "bag" in request.fixturenames:
        yield
        return
    system: System = request.getfixturevalue("system")
    states = MOTION_STATE.subscriber(request.getfixturevalue("node"))

    def behavior() -> str:
        states.drain()
        return str(wait_until(lambda: states.receive(timeout=1.0), 60.0, "MotionState").message.behavior)

    with left_standing(lambda: system.valorctl("mode", "stand"), behavior, ("stand", "stand_manipulate")):
        yield
    states.close()


@pytest.fixture
def ros(system: System) -> Iterator[RosClient]:
    """An ordinary ROS 2 client."""
    client = RosClient(system.join())
    yield client
    client.close()


@pytest.fixture
def viewer(system: System, port: int) -> Iterator[Viewer]:
    """A client of the Foxglove bridge."""
    if not FOXGLOVE:
        pytest.skip("the extra foxglove is not installed")
    with Viewer(port) as looking:
        yield looking
