"""An instance on several computers, each a network namespace with a home and an ssh server of its own."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil

from harness.computers import Computers, ComputersError, computers, environment
from harness.places import REPOSITORY
from harness.system import VALORCTL
from harness.waiting import wait_until
from valor.common.instance import Instance
from valor.common.resources import file_of
from valor.valorctl.hosts.deployment import Deployment
from valor.valorctl.instance import shutdown

TIMEOUT = 240.0  # of a verb [s]
SSH_PORT = 2222


def make_ssh_keys(folder: Path) -> Path:
    """Make the keys of a server and of a user, and an ``ssh_config`` by which each is accepted; returns that file."""
    folder.mkdir()
    for name in ("host_key", "user_key"):
        subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", folder / name], check=True)
    (folder / "authorized_keys").write_text((folder / "user_key.pub").read_text())
    (folder / "known_hosts").write_text(f"* {(folder / 'host_key.pub').read_text()}")
    options = {
        "IdentityFile": folder / "user_key",
        "IdentitiesOnly": "yes",
        "IdentityAgent": "none",
        "UserKnownHostsFile": folder / "known_hosts",
        "GlobalKnownHostsFile": "/dev/null",
        "StrictHostKeyChecking": "yes",
        "HostKeyAlias": "host",
        "Port": SSH_PORT,
    }
    config = folder / "ssh_config"
    config.write_text("".join(f"{name} {value}\n" for name, value in options.items()))
    return config


def start_ssh_server(
    command: Sequence[str], address: str, keys: Path, environment: dict[str, str], log: Path
) -> subprocess.Popen[bytes]:
    """Start a computer's ssh server, and wait until it listens; ``command``: what runs a program on that computer."""
    with open(log, "wb") as out:
        server = subprocess.Popen(
            [*command, sys.executable, "-m", "harness.ssh_server", address, str(SSH_PORT), str(keys)],
            env=environment | {"PYTHONPATH": str(REPOSITORY)},
            cwd=log.parent,
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # Ctrl-C in a benchmark must not end it before `down`
        )
    wait_until(lambda: "listens" in log.read_text(), 30.0, f"ssh server listens: {log.read_text()}")
    return server


class Hosts:
    """The computers of a deployment, and what `valorctl` does on them."""

    def __init__(self, network: Computers, folder: Path, deployment: str, instance: str) -> None:
        self.network, self.folder, self.instance = network, folder, instance
        self.file = folder / "trio.yaml"
        self._keys = folder / "ssh"
        config = make_ssh_keys(self._keys)
        key = folder / "trio.key"
        key.write_bytes(os.urandom(32))
        key.chmod(0o600)
        for name, address in {**network.addresses, "between": network.between[1]}.items():
            deployment = deployment.replace(f"@{name}", address)
        self.file.write_text(f"{deployment}ssh: {{config: {config}}}\n")
        self.ahead = dict.fromkeys(network.addresses, 0.0)  # of each one's clock since boot [s]
        self._servers: dict[str, subprocess.Popen[bytes]] = {}
        for name in network.addresses:
            self.home(name).mkdir()

    def home(self, name: str) -> Path:
        """Folder of a computer's instances."""
        return self.folder / name

    def command(self, name: str, *arguments: str) -> list[str]:
        """A command that runs on a computer."""
        return [*self.network.inside(name, ahead=self.ahead[name]), *arguments]

    def environment(self, name: str) -> dict[str, str]:
        """Environment of a command on a computer."""
        return environment(self.home(name), self.instance) | {"PATH": f"{VALORCTL.parent}:{os.environ['PATH']}"}

    def valorctl(self, name: str, *arguments: str, expect: int = 0, timeout: float = TIMEOUT) -> str:
        """Run a verb on a computer; returns its output, stderr included."""
        done = subprocess.run(
            self.command(name, str(VALORCTL), *arguments),
            env=self.environment(name),
            cwd=self.folder,
            capture_output=True,
            text=True,
            timeout=timeout,
            stdin=subprocess.DEVNULL,
            check=False,
        )
        output = done.stdout + done.stderr
        assert done.returncode == expect, f"{name}: {' '.join(arguments)}: exit {done.returncode}\n{output}"
        return output

    def status(self, name: str) -> dict[str, Any]:
        """``valorctl status --json`` on a computer."""
        found: dict[str, Any] = json.loads(self.valorctl(name, "status", "--json"))
        return found

    def states(self, name: str) -> dict[str, str]:
        """States of the processes, as a computer reports them."""
        return {row["name"]: row["state"] for row in self.status(name)["services"]}

    def left(self, name: str) -> list[psutil.Process]:
        """Processes of the instance on a computer."""
        return shutdown.processes_of(Instance(self.instance, self.home(name)))

    def start_ssh(self, name: str, instead: Sequence[tuple[Path, Path]] = ()) -> None:
        """Start a computer's ssh server; ``instead``: files that its commands see in the place of others."""
        mounts = "".join(f"mount --bind {file} {place} && " for file, place in instead)
        own = ("unshare", "--mount", "sh", "-c", f'{mounts}exec "$@"', "sh") if instead else ()
        self._servers[name] = start_ssh_server(
            self.command(name, *own),
            self.network.addresses[name],
            self._keys,
            self.environment(name),
            self.folder / f"{name}.ssh",
        )

    def kill_ssh(self, name: str) -> None:
        """Kill a computer's ssh server, with its connections."""
        server = self._servers.pop(name)
        server.kill()
        server.wait()

    @contextmanager
    def little_disk(self, name: str, size: str) -> Iterator[Path]:
        """Give a computer's ssh server an empty folder of the instance on a separate disk of a size.

        Raises:
            ComputersError: such a disk cannot be made here.
        """
        folder = self.home(name) / self.instance
        folder.mkdir(exist_ok=True)
        inside = ("nsenter", "--target", str(self._servers[name].pid), "--mount")
        made = subprocess.run(
            [*inside, "mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)],
            capture_output=True,
            text=True,
            check=False,
        )
        if made.returncode:
            raise ComputersError(f"no small disks here: {made.stderr.strip()}")
        try:
            yield Path(f"/proc/{self._servers[name].pid}/root") / folder.relative_to("/")
        finally:
            subprocess.run([*inside, "umount", "--lazy", str(folder)], check=False)

    def cut_power(self, name: str) -> None:
        """Kill a computer's ssh server and all that runs there at once, as a loss of power does; its files stay."""
        self.kill_ssh(name)
        self._kill_rest(name)

    def restore_power(self, name: str) -> str:
        """Start a computer's ssh, then what its unit calls; returns the output of that."""
        self.start_ssh(name)
        return self.valorctl(name, "host", "resume")

    def kill_supervisor(self, name: str) -> None:
        """Kill a computer's supervisord only; its processes continue."""
        for process in self.left(name):
            if "supervisor.supervisord" in process.cmdline():
                process.kill()

    def _kill_rest(self, name: str) -> None:
        for process in self.left(name):
            with contextlib.suppress(psutil.NoSuchProcess):
                process.kill()

    def close(self) -> None:
        """Everything down, and no ssh server left."""
        for name in self.network.addresses:
            self.network.plug(name)
        try:
            names = list(self._servers)
            if names:
                self.valorctl(names[-1], "down", "--deployment", str(self.file))
            if Deployment.load(self.file).link is not None:  # whose two sides are two for `down`
                self.valorctl(names[0], "down", "--deployment", str(self.file))
        finally:
            for name in list(self._servers):
                self.kill_ssh(name)
            for name in self.network.addresses:
                self._kill_rest(name)


def deployment_text(name: str) -> str:
    """One of the project's deployments, with ``@name`` in the place of each host's address."""
    file = file_of("deployment", name)
    text = file.read_text()
    for host, row in Deployment.load(file).hosts.items():
        text = text.replace(row.address, f"@{host}")
    return text


@contextmanager
def hosts(
    folder: Path, deployment: str, instance: str, *names: str, apart: Collection[str] = (), **ahead: float
) -> Iterator[Hosts]:
    """Computers of a deployment, in whose text ``@name`` stands for an address.

    Args:
        folder: short, since sockets are made in it.
        deployment: the file's text.
        instance: name of the instance.
        names: of the computers.
        apart: names of those on the second switch; ``@between`` is the address of what joins the switches.
        ahead: offset of a computer's clock since boot [s].

    Raises:
        ComputersError: network or time namespaces cannot be made here.
    """
    if ahead and subprocess.run(["unshare", "--time", "true"], capture_output=True, check=False).returncode:
        raise ComputersError("no time namespaces here")
    with computers(*names, network=os.getpid() % 250, apart=apart) as network:
        made = Hosts(network, folder, deployment, instance)
        made.ahead |= ahead
        try:
            for name in names:
                made.start_ssh(name)
            yield made
        finally:
            made.close()
