"""Fixtures: an instance of one's own, with real processes and real sockets, that leaves nothing behind."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import hypothesis
import pytest
from hypothesis.database import DirectoryBasedExampleDatabase

import bifrost
from valor.common.instance import Instance, Settings
from valor.common.processes import BY_NAME
from valor.common.table import checked, plain
from valor.common.topics import STATISTICS
from valor.valorctl.ros_domain import daemon_ports, reserve, reserve_for

REPOSITORY = Path(__file__).resolve().parent.parent
ROBOTS = REPOSITORY / "robots"
T = TypeVar("T")
FUZZ = int(os.environ.get("FUZZ", "0"))
"""Of ``make fuzz``: so many times the examples, other ones each time; 0: the same ones on every run."""
# How long an example takes is the machine's matter.
hypothesis.settings.register_profile(
    "valor",
    deadline=None,
    suppress_health_check=[hypothesis.HealthCheck.too_slow],
    derandomize=not FUZZ,
    database=DirectoryBasedExampleDatabase(REPOSITORY / ".hypothesis" / "examples") if FUZZ else None,
    print_blob=bool(FUZZ),
    max_examples=100 * max(1, FUZZ),
)
hypothesis.settings.load_profile("valor")
# A shell starts what runs in its background with SIGINT ignored, and that is inherited: the processes that tests
# interrupt would go on for ever.
signal.signal(signal.SIGINT, signal.default_int_handler)
PATIENCE = 60.0
"""For anything to happen on a computer that is busy with other work [s]; what does happen is waited for no longer."""
THREADS = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


def examples(count: int, *allowed: hypothesis.HealthCheck) -> hypothesis.settings:
    """Settings of a property test: how many examples it tries, unless fuzzed, and what it may do besides."""
    checks = [*hypothesis.settings().suppress_health_check, *allowed]
    return hypothesis.settings(max_examples=count * max(1, FUZZ), suppress_health_check=checks)


def wait_until(condition: Callable[[], T], timeout: float, what: str, period: float = 0.02) -> T:
    """Poll until ``condition()`` is true; returns what it gave.

    Raises:
        AssertionError: not within ``timeout`` [s], nor within ``PATIENCE``; names ``what``.
    """
    timeout = max(timeout, PATIENCE)
    deadline = time.monotonic() + timeout
    while True:
        if value := condition():
            return value
        if time.monotonic() > deadline:
            raise AssertionError(f"not within {timeout:g} s: {what}")
        time.sleep(period)


@dataclass
class RunningInstance:
    """An instance without a supervisor: a test starts, stops and kills its processes by name."""

    instance: Instance
    network: bifrost.Network
    _running: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)
    _nodes: list[bifrost.Node] = field(default_factory=list)

    @property
    def environment(self) -> dict[str, str]:
        """What any process joins the instance with, on top of this process' own environment."""
        return os.environ | THREADS | self.instance.environment()

    @property
    def settings(self) -> Settings:
        """As ``valorctl up`` would have written them."""
        return self.instance.settings()

    def configure(self, **changes: object) -> None:
        """Change settings; processes started from now on see them."""
        settings = checked(Settings, plain(self.settings) | changes)
        self.instance.settings_file.write_text(settings.json())

    def start(self, name: str, *, env: dict[str, str] | None = None, wait: bool = False) -> subprocess.Popen[bytes]:
        """Start a process of the table; its output goes to ``log(name)``."""
        assert name not in self._running, f"{name} runs already"
        with open(self.instance.logs / f"{name}.log", "ab") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", BY_NAME[name].module],
                env=self.environment | (env or {}),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        self._running[name] = process
        if wait:
            self.wait_ready(name)
        return process

    def process(self, name: str) -> subprocess.Popen[bytes]:
        """The process started under a name."""
        return self._running[name]

    def stop(self, name: str, timeout: float = 10.0) -> int:
        """SIGTERM, and wait; returns the exit status."""
        process = self._running.pop(name)
        process.terminate()
        try:
            return process.wait(timeout)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            raise AssertionError(
                f"{name} did not stop within {timeout:g} s of SIGTERM; log:\n{self.log(name)}"
            ) from None

    def kill(self, name: str) -> None:
        """SIGKILL, and wait."""
        process = self._running.pop(name)
        process.kill()
        process.wait()

    def log(self, name: str) -> str:
        """What the process has printed."""
        return (self.instance.logs / f"{name}.log").read_text(errors="replace")

    def node(self, name: str = "test") -> bifrost.Node:
        """A Bifrost node in this process; closed with the fixture."""
        node = bifrost.Node(name, network=self.network)
        self._nodes.append(node)
        return node

    def wait_ready(self, name: str, timeout: float = 30.0) -> None:
        """Wait until the process says that it is ready.

        Raises:
            AssertionError: it died or did not say so; carries its log.
        """
        process = self._running[name]
        with bifrost.Node(f"waiting_for_{name}", network=self.network) as node:
            statistics = STATISTICS[name].subscriber(node)
            deadline = time.monotonic() + timeout
            while time.monotonic() < deadline:
                received = statistics.receive(timeout=0.2)
                if received and received.message.pid == process.pid and received.message.state == "ready":
                    return
                assert process.poll() is None, f"{name} ended with {process.returncode}; log:\n{self.log(name)}"
        raise AssertionError(f"{name} not ready within {timeout:g} s; log:\n{self.log(name)}")

    def close(self) -> None:
        """End everything."""
        for node in self._nodes:
            node.close()
        for process in reversed(self._running.values()):
            process.terminate()
        for process in self._running.values():
            try:
                process.wait(5)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()


@pytest.fixture
def home() -> Iterator[Path]:
    """A short-named VALOR_HOME of the test's own (socket names are limited to 108 bytes)."""
    folder = Path(tempfile.mkdtemp(prefix="valor-"))
    yield folder
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture(scope="session")
def ros_domain() -> Iterator[int]:
    """A ROS domain, and the ports that go with it, that nobody else on this computer has."""
    with reserve(f"tests {os.getpid()}") as reservation:
        yield reservation.domain


@contextmanager
def fresh_instance(home: Path, name: str = "test", **settings: object) -> Iterator[RunningInstance]:
    """An instance with ``bifrostd`` running, in a ROS domain of its own.

    Args:
        home: its VALOR_HOME.
        name: of the instance.
        settings: that differ from free-running lockstep, hardware actuators and seed 0.
    """
    made = Instance(name, home)
    made.logs.mkdir(parents=True)
    made.bags.mkdir()
    with reserve_for(made) as reservation:
        domain = reservation.domain
        usual = {"robot": str(ROBOTS / "escher"), "ros_domain_id": domain, "real_time_factor": 0.0}
        made.settings_file.write_text(checked(Settings, usual | settings).json())
        running = RunningInstance(
            made, bifrost.Network.create(made.network_file, made.keys, ports=daemon_ports(domain))
        )
        try:
            running.start("bifrostd")
            yield running
        finally:
            running.close()


@pytest.fixture
def instance(home: Path) -> Iterator[RunningInstance]:
    """A ``fresh_instance`` of the test's own."""
    with fresh_instance(home) as running:
        yield running
