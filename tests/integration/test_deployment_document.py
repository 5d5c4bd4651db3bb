"""docs/deployment.md, done word for word: three computers, each with a home of its own, from tickets to `down`."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from harness.computers import Computers, ComputersError, computers
from harness.system import VALORCTL
from harness.waiting import wait_until

pytestmark = pytest.mark.timeout(900)
PROJECT = Path(__file__).parents[2]
TEXT = (PROJECT / "docs/deployment.md").read_text()
NAMES = ("motion", "perception", "operator")


def blocks(heading: str) -> list[list[str]]:
    """The commands of each code block below a heading, without comments."""
    section = TEXT.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    found = re.findall(r"^```\n(.*?)^```$", section, re.DOTALL | re.MULTILINE)
    return [[shlex.join(shlex.split(line, comments=True)) for line in block.splitlines()] for block in found]


class Three:
    """Computers on which somebody types."""

    def __init__(self, network: Computers, folder: Path) -> None:
        self.network = network
        self.homes = {name: folder / name for name in NAMES}
        self.agents: list[subprocess.Popen[bytes]] = []
        for home in self.homes.values():
            home.mkdir()
        (self.homes["operator"] / "deploy").symlink_to(PROJECT / "deploy")

    def command(self, name: str, line: str) -> tuple[list[str], dict[str, str]]:
        """A line as it is typed on a computer, and its environment."""
        own = {
            key: value for key, value in os.environ.items() if not key.startswith(("ROS_", "FAST", "VALOR", "BIFROST"))
        }
        path = f"{VALORCTL.parent}:{os.environ['PATH']}"
        return [*self.network.inside(name), "sh", "-c", line], own | {"HOME": str(self.homes[name]), "PATH": path}

    def type(self, name: str, line: str) -> str:
        """Type a line in a computer's home; what it says."""
        command, environment = self.command(name, line)
        done = subprocess.run(
            command, env=environment, cwd=self.homes[name], capture_output=True, text=True, timeout=300.0, check=False
        )
        assert done.returncode == 0, f"{name}: {line}: exit {done.returncode}\n{done.stdout}{done.stderr}"
        return done.stdout

    def follow(self, shown: str) -> None:
        """Do what `host join` shows: the ticket goes to its computer, where the agent is started."""
        words = re.search(r"scp -p (\S+) (\S+): && ssh -t \2 (.*)", shown)
        assert words, shown
        name = next(name for name, address in self.network.addresses.items() if address == words[2])
        if name != "operator":
            shutil.move(self.homes["operator"] / words[1], self.homes[name] / words[1])
        self._start(name, words[3])

    def _start(self, name: str, line: str) -> None:
        said = self.homes[name] / "agent.log"
        command, environment = self.command(name, f"exec {line}")
        with open(said, "wb") as out:
            self.agents.append(subprocess.Popen(command, env=environment, cwd=self.homes[name], stdout=out, stderr=out))
        wait_until(lambda: "listens" in said.read_text(), 60.0, f"the agent of {name} listens")

    def end_agents(self) -> None:
        """Nobody listens any more."""
        for agent in self.agents:
            agent.terminate()
            agent.wait(30.0)
        self.agents.clear()


@contextmanager
def three() -> Iterator[Three]:
    with tempfile.TemporaryDirectory(prefix="vd-", ignore_cleanup_errors=True) as folder:
        try:
            with computers(*NAMES) as network:  # with the addresses of our deployments
                made = Three(network, Path(folder))
                try:
                    yield made
                finally:
                    try:
                        for name in reversed(NAMES[1:]):  # of a failure; else it is down
                            if made.agents:
                                made.type(name, "test ! -e .valor/default/instance.json || valorctl down")
                    finally:
                        made.end_agents()
        except ComputersError as error:
            pytest.skip(str(error))


def test_from_three_empty_computers_to_a_walking_robot() -> None:
    tickets, verbs = blocks("From three empty computers to a walking robot")
    with three() as made:
        for line in tickets:
            said = made.type("operator", line)
            if " host join " in line:
                made.follow(said)
        heard = {line.split()[1]: made.type("operator", line) for line in verbs}
        assert list(heard) == ["up", "status", "walk", "mode", "arm", "down"]
        assert all(name in heard["up"] and name in heard["status"] for name in NAMES)
        walked = re.search(r"(\d+\.\d+) m", heard["walk"])
        assert walked and float(walked[1]) > 2.0, heard["walk"]
        assert "down on every host" in heard["down"]
