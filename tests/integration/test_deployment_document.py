"""docs/deployment.md, word for word: three computers, each with a home of its own, from empty folders to `down`."""

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
from harness.hosts import make_ssh_keys, start_ssh_server
from harness.system import VALORCTL

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
    """Computers with ssh servers, and commands typed on them."""

    def __init__(self, network: Computers, folder: Path) -> None:
        self.network = network
        self.homes = {name: folder / name for name in NAMES}
        config = make_ssh_keys(folder / "ssh")
        self.servers: list[subprocess.Popen[bytes]] = []
        (folder / "bin").mkdir()
        ssh = folder / "bin/ssh"  # as if `config` were each user's own
        ssh.write_text(f'#!/bin/sh\nexec {shutil.which("ssh")} -F {config} "$@"\n')
        ssh.chmod(0o755)
        self.path = f"{ssh.parent}:{VALORCTL.parent}:{os.environ['PATH']}"
        for name, home in self.homes.items():
            home.mkdir()
            address, log = network.addresses[name], home / "ssh.log"
            command = network.inside(name)
            self.servers.append(start_ssh_server(command, address, config.parent, self.environment(name), log))
        (self.homes["operator"] / "deploy").symlink_to(PROJECT / "deploy")

    def environment(self, name: str) -> dict[str, str]:
        own = {
            key: value for key, value in os.environ.items() if not key.startswith(("ROS_", "FAST", "VALOR", "BIFROST"))
        }
        return own | {"HOME": str(self.homes[name]), "PATH": self.path}

    def type(self, name: str, line: str) -> str:
        """Type a line in a computer's home; returns its output."""
        done = subprocess.run(
            [*self.network.inside(name), "sh", "-c", line], env=self.environment(name), cwd=self.homes[name],
            capture_output=True, text=True, timeout=300.0, check=False,
        )  # fmt: skip
        assert done.returncode == 0, f"{name}: {line}: exit {done.returncode}\n{done.stdout}{done.stderr}"
        return done.stdout

    def close(self) -> None:
        for server in self.servers:
            server.kill()
            server.wait()


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
                        made.type("operator", "test ! -e .valor/default/instance.json || valorctl down")
                    finally:
                        made.close()
        except ComputersError as error:
            pytest.skip(str(error))


def test_from_three_empty_computers_to_a_walking_robot() -> None:
    before, verbs = blocks("From three empty computers to a walking robot")
    with three() as made:
        for line in before:
            made.type("operator", line)
        shown = {line.split()[1]: made.type("operator", line) for line in verbs}
        assert list(shown) == ["up", "status", "walk", "mode", "arm", "down"]
        assert all(name in shown["up"] and name in shown["status"] for name in NAMES)
        walked = re.search(r"(\d+\.\d+) m", shown["walk"])
        assert walked and float(walked[1]) > 2.0, shown["walk"]
        assert "down on every host" in shown["down"]
