"""Fixtures of the Bifrost tests: networks of a test's own."""

from __future__ import annotations

import contextlib
import random
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from bifrost import Computer
from tests.bifrost.network import BifrostNetwork


@pytest.fixture
def bare_network(tmp_path: Path) -> Iterator[BifrostNetwork]:
    """A network of one computer whose daemon does not run yet."""
    made = BifrostNetwork(tmp_path)
    yield made
    made.close()


@pytest.fixture
def own_net(bare_network: BifrostNetwork) -> BifrostNetwork:
    """The same, its daemon running: to be killed, and otherwise ill-treated."""
    bare_network.start_daemon()
    return bare_network


@pytest.fixture(scope="session")
def lasting_network(tmp_path_factory: pytest.TempPathFactory) -> Iterator[BifrostNetwork]:
    """A network whose daemon runs as long as the tests do."""
    made = BifrostNetwork(tmp_path_factory.mktemp("network"))
    made.start_daemon()
    yield made
    made.close()


@pytest.fixture
def net(lasting_network: BifrostNetwork) -> Iterator[BifrostNetwork]:
    """A network whose daemon runs, and knows nobody else: what a test starts in it ends with the test."""
    yield lasting_network
    lasting_network.dismiss()


@pytest.fixture
def two_computers(tmp_path: Path) -> Iterator[BifrostNetwork]:
    """Two computers, near and far, that are two addresses of the loopback interface; no daemon runs yet."""
    port = _free_port()
    made = BifrostNetwork(tmp_path, [Computer("near", "127.0.0.1", port), Computer("far", "127.0.0.2", port)])
    yield made
    made.close()


def _free_port() -> int:
    """One that nobody listens on, on whichever address."""
    while True:
        port = random.SystemRandom().randrange(20000, 32768)
        with socket.socket() as probe, contextlib.suppress(OSError):
            probe.bind(("0.0.0.0", port))
            return port
