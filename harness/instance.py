"""An instance of one's own, with real processes and real sockets, that leaves nothing behind."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import bifrost
from harness.places import ROBOTS
from valor.common.instance import Instance, Settings
from valor.common.processes import BY_NAME, DAEMON
from valor.common.table import checked, plain
from valor.common.topics import STATISTICS
from valor.valorctl.instance.ros_domain import daemon_ports, reserve_for

THREADS = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


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

    def stop(self, name: str, timeout: float = 30.0) -> int:
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

    def reset(self, settings: Settings) -> None:
        """End all processes but bifrostd and all nodes; restore the settings; remove logs and bags."""
        daemon = self._running.pop(DAEMON, None)
        self.close()
        self._nodes.clear()
        self._running.clear()
        for folder in (self.instance.bags, self.instance.logs):
            shutil.rmtree(folder)
            folder.mkdir()
        self.instance.settings_file.write_text(settings.json())
        if daemon is None or daemon.poll() is not None:
            self.start(DAEMON)
        else:
            self._running[DAEMON] = daemon

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
            running.start(DAEMON)
            yield running
        finally:
            running.close()
