"""Computers as network namespaces, each with a cable to one of two switches; their clocks can differ."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

NO_COMPUTERS = "no network namespaces with cables between them here"


class ComputersError(Exception):
    """Network namespaces cannot be made here."""


class Computers:
    """Computers on one switch: 10.76.<network>.1, .2, …, in the order of their names; others on 10.77.<network>.

    Attributes:
        addresses: by name.
        between: addresses of a computer on both switches, which forwards nothing.
    """

    def __init__(self, names: tuple[str, ...], network: int, apart: Collection[str] = ()) -> None:
        self._apart = frozenset(apart)
        nets = {False: f"10.76.{network}", True: f"10.77.{network}"}
        self.addresses = {name: f"{nets[name in apart]}.{index}" for index, name in enumerate(names, 1)}
        self.between = (f"{nets[False]}.254", f"{nets[True]}.254")
        self._prefix = f"valor_{os.getpid()}_{network}"
        self._switch = f"{self._prefix}_switch"
        self._port = {name: f"v{os.getpid()}{network}s{index}" for index, name in enumerate(names)}

    def inside(self, name: str, *, ahead: float = 0.0) -> tuple[str, ...]:
        """Prefix of a command that runs on a computer, whose clock since boot can be ahead [s]."""
        clock = ("unshare", "--time", f"--monotonic={ahead:g}", f"--boottime={ahead:g}") if ahead else ()
        return ("ip", "netns", "exec", self._name(name), *clock)

    def inside_between(self) -> tuple[str, ...]:
        """Prefix of a command that runs between the switches."""
        return ("ip", "netns", "exec", self._switch)

    def pull(self, name: str) -> None:
        """Pull a computer's cable: its interface loses the carrier and keeps its address."""
        self._cable(name, "down")

    def plug(self, name: str) -> None:
        """Plug it in again."""
        self._cable(name, "up")

    def _cable(self, name: str, state: str) -> None:
        _run("ip", "netns", "exec", self._switch, "ip", "link", "set", self._port[name], state)

    def _name(self, computer: str) -> str:
        return f"{self._prefix}_{computer}"

    def make(self, stack: ExitStack) -> None:
        """Make them; ``stack`` removes them.

        Raises:
            ComputersError: network namespaces cannot be made here.
        """
        for space in (self._switch, *map(self._name, self.addresses)):
            _run("ip", "netns", "add", space)
            stack.callback(subprocess.run, ["ip", "netns", "delete", space], check=False)
            _run("ip", "-n", space, "link", "set", "lo", "up")
        for switch, address in zip(("switch", "apart"), self.between, strict=True):
            _run("ip", "-n", self._switch, "link", "add", switch, "type", "bridge")
            _run("ip", "-n", self._switch, "address", "add", f"{address}/24", "dev", switch)
            _run("ip", "-n", self._switch, "link", "set", switch, "up")
        for name, address in self.addresses.items():
            port, own = self._port[name], f"{self._port[name]}x"
            _run("ip", "link", "add", port, "netns", self._switch, "type", "veth", "peer", "name", own)
            _run("ip", "link", "set", own, "netns", self._name(name))
            switch = "apart" if name in self._apart else "switch"
            _run("ip", "-n", self._switch, "link", "set", port, "master", switch, "up")
            _run("ip", "-n", self._name(name), "address", "add", f"{address}/24", "dev", own)
            _run("ip", "-n", self._name(name), "link", "set", own, "up")


@contextmanager
def computers(*names: str, network: int = 0, apart: Collection[str] = ()) -> Iterator[Computers]:
    """Make computers, and remove them; ``apart``: names of those on the second switch.

    Raises:
        ComputersError: network namespaces cannot be made here.
    """
    with ExitStack() as stack:
        made = Computers(names, network, apart)
        made.make(stack)
        yield made


def environment(home: Path, instance: str, more: Mapping[str, str] | None = None) -> dict[str, str]:
    """Environment of a command on a computer with this home."""
    own = {k: v for k, v in os.environ.items() if not k.startswith(("ROS_", "FAST", "VALOR", "BIFROST"))}
    return own | {"VALOR_HOME": str(home), "VALOR_INSTANCE": instance} | dict(more or {})


def _run(*command: str) -> None:
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        raise ComputersError(f"{NO_COMPUTERS}: {error}") from None
    if done.returncode:
        raise ComputersError(f"{NO_COMPUTERS}: {' '.join(command)}: {done.stderr.strip()}")
