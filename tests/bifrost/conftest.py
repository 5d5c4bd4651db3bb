"""Fixtures of the Bifrost tests: networks for one test or module."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from harness import bifrost_network as network
from harness.bifrost_network import BifrostNetwork
from valor.valorctl.instance.ros_domain import daemon_ports


@pytest.fixture
def bare_network(tmp_path: Path, ros_domain: int) -> Iterator[BifrostNetwork]:
    """A network of one computer whose daemon does not run yet."""
    made = BifrostNetwork(tmp_path, daemon_ports(ros_domain))
    yield made
    made.close()


@pytest.fixture
def own_net(bare_network: BifrostNetwork) -> BifrostNetwork:
    """The same, its daemon running: to be killed, and otherwise ill-treated."""
    bare_network.start_daemon()
    return bare_network


@pytest.fixture(scope="session")
def lasting_network(tmp_path_factory: pytest.TempPathFactory, ros_domain: int) -> Iterator[BifrostNetwork]:
    """A network whose daemon runs as long as the tests do."""
    made = BifrostNetwork(tmp_path_factory.mktemp("network"), daemon_ports(ros_domain))
    made.start_daemon()
    yield made
    made.close()


@pytest.fixture
def net(lasting_network: BifrostNetwork) -> Iterator[BifrostNetwork]:
    """A network whose daemon runs, and knows nobody else: what a test starts in it ends with the test."""
    yield lasting_network
    lasting_network.dismiss()


@pytest.fixture
def two_computers(tmp_path: Path, ros_domain: int) -> Iterator[BifrostNetwork]:
    """Two computers, near and far, that are two addresses of the loopback interface; no daemon runs yet."""
    ports = daemon_ports(ros_domain)
    made = BifrostNetwork(tmp_path, ports, network.two_computers(tmp_path, ports))
    yield made
    made.close()
