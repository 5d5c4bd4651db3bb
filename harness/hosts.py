"""An instance on several computers, each a network namespace with a home and an agent of its own."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil

from harness.computers import Computers, ComputersError, computers, environment
from harness.system import VALORCTL
from harness.waiting import wait_until
from valor.common.instance import Instance
from valor.valorctl import leftovers
from valor.valorctl.hosts.deployment import Deployment, deployment_file

PATIENCE = 240.0  # [s]


class Hosts:
    """The computers of a deployment, and what `valorctl` does on them."""

    def __init__(self, network: Computers, folder: Path, deployment: str, instance: str) -> None:
        self.network, self.folder, self.instance = network, folder, instance
        self.file = folder / "trio.yaml"
        for name, address in {**network.addresses, "between": network.between[1]}.items():
            deployment = deployment.replace(f"@{name}", address)
        self.file.write_text(deployment)
        self.ahead = dict.fromkeys(network.addresses, 0.0)  # of each one's clock since boot [s]
        self._agents: dict[str, subprocess.Popen[bytes]] = {}
        for name in network.addresses:
            self.home(name).mkdir()

    def home(self, name: str) -> Path:
        """Where a computer keeps its instances."""
        return self.folder / name

    def command(self, name: str, *arguments: str) -> list[str]:
        """A command as it is run on a computer."""
        return [*self.network.inside(name, ahead=self.ahead[name]), *arguments]

    def environment(self, name: str) -> dict[str, str]:
        """Of a command on a computer."""
        return environment(self.home(name), self.instance)

    def valorctl(self, name: str, *arguments: str, expect: int = 0, timeout: float = PATIENCE) -> str:
        """Run a verb on a computer; what it said, complaints included."""
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
        said = done.stdout + done.stderr
        assert done.returncode == expect, f"{name}: {' '.join(arguments)}: exit {done.returncode}\n{said}"
        return said

    def status(self, name: str) -> dict[str, Any]:
        """``valorctl status --json`` on a computer."""
        found: dict[str, Any] = json.loads(self.valorctl(name, "status", "--json"))
        return found

    def states(self, name: str) -> dict[str, str]:
        """How the processes fare, as a computer sees it."""
        return {row["name"]: row["state"] for row in self.status(name)["services"]}

    def left(self, name: str) -> list[psutil.Process]:
        """What runs of the instance on a computer."""
        return leftovers.processes_of(Instance(self.instance, self.home(name)))

    def join(self, name: str, first: str) -> None:
        """Bring a computer its ticket from the first, and start its agent."""
        self.valorctl(first, "host", "join", name, "--deployment", str(self.file))
        self.start_agent(name, f"trio.{name}.ticket")

    def start_agent(self, name: str, ticket: str = "trio", instead: Sequence[tuple[Path, Path]] = ()) -> None:
        """Start a computer's agent, and wait until it listens; ``instead``: files that it sees at others' places."""
        mounts = "".join(f"mount --bind {file} {place} && " for file, place in instead)
        own = ("unshare", "--mount", "sh", "-c", f'{mounts}exec "$@"', "sh") if instead else ()
        said = self.folder / f"{name}.agent"
        with open(said, "wb") as out:
            self._agents[name] = subprocess.Popen(
                self.command(name, *own, str(VALORCTL), "host", "agent", ticket),
                env=self.environment(name),
                cwd=self.folder,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # whoever interrupts a benchmark needs it to take all down
            )
        wait_until(lambda: "listens" in said.read_text(), 30.0, f"the agent of {name} listens: {said.read_text()}")

    def stop_agent(self, name: str) -> None:
        """End a computer's agent."""
        agent = self._agents.pop(name)
        agent.terminate()
        agent.wait(30.0)

    @contextmanager
    def little_disk(self, name: str, size: str) -> Iterator[Path]:
        """While it lasts a computer's agent has the instance's folder, empty, on a disk of its own of a size.

        Raises:
            ComputersError: no disk is to be had here.
        """
        folder = self.home(name) / self.instance
        folder.mkdir(exist_ok=True)
        inside = ("nsenter", "--target", str(self._agents[name].pid), "--mount")
        made = subprocess.run(
            [*inside, "mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)],
            capture_output=True,
            text=True,
            check=False,
        )
        if made.returncode:
            raise ComputersError(f"no small disks here: {made.stderr.strip()}")
        try:
            yield Path(f"/proc/{self._agents[name].pid}/root") / folder.relative_to("/")
        finally:
            subprocess.run([*inside, "umount", "--lazy", str(folder)], check=False)

    def kill_agent(self, name: str) -> None:
        """End a computer's agent, which has no time to say anything."""
        self._agents[name].kill()
        self._agents.pop(name).wait()

    def cut_power(self, name: str) -> None:
        """End a computer's agent and all that runs there at once, as when its power is cut; its files stay."""
        self.kill_agent(name)
        self._kill_rest(name)

    def _kill_rest(self, name: str) -> None:
        for process in self.left(name):
            with contextlib.suppress(psutil.NoSuchProcess):
                process.kill()

    def close(self) -> None:
        """Everything down, and no agent left."""
        for name in self.network.addresses:
            self.network.plug(name)
        try:
            here = next(reversed(self._agents), None)
            if here is not None:
                self.valorctl(here, "down", "--deployment", str(self.file))
            if Deployment.load(self.file).link is not None:  # whose two sides are not one to `down`
                self.valorctl(next(iter(self._agents)), "down", "--deployment", str(self.file))
        finally:
            for name in list(self._agents):
                self.stop_agent(name)
            for name in self.network.addresses:
                self._kill_rest(name)


def deployment_text(name: str) -> str:
    """One of the project's deployments, as ``hosts`` takes it: of each host ``@name`` in the place of its address."""
    file = deployment_file(name)
    text = file.read_text()
    for host, row in Deployment.load(file).hosts.items():
        text = text.replace(row.address, f"@{host}")
    return text


@contextmanager
def hosts(
    folder: Path, deployment: str, instance: str, *names: str, apart: Collection[str] = (), **ahead: float
) -> Iterator[Hosts]:
    """Computers that have joined a deployment, in whose text ``@name`` stands for an address.

    Args:
        folder: short, for sockets are made in it.
        deployment: the file's text.
        instance: name of the instance.
        names: of the computers; the last is where keys are made.
        apart: those that nothing joins with the others but what is between them, whose address is ``@between``.
        ahead: by how much a computer's clock since boot is ahead [s].

    Raises:
        ComputersError: there are no such computers to be had here.
    """
    if ahead and subprocess.run(["unshare", "--time", "true"], capture_output=True, check=False).returncode:
        raise ComputersError("no time namespaces here")
    with computers(*names, network=os.getpid() % 250, apart=apart) as network:
        made = Hosts(network, folder, deployment, instance)
        made.ahead |= ahead
        try:
            for name in names:
                made.join(name, names[-1])
            yield made
        finally:
            made.close()
