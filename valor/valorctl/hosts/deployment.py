"""Deployments: files that say on which hosts an instance runs, and which process on which."""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from valor.common import resources
from valor.common.errors import ConfigurationError, expected
from valor.common.instance import Host, Link
from valor.common.linking import NAMES
from valor.common.processes import BY_NAME, DAEMON
from valor.common.resources import profile_file
from valor.common.table import Table, TableError, read
from valor.valorctl.hosts.apart import LinkRow, require_apart
from valor.valorctl.profile import Profile

AGENT_PORT = 7311  # TCP; below Linux' ephemeral ports
_NAME = re.compile(r"[a-z0-9][a-z0-9-]{0,30}")
_NAMES = "lower-case letters, digits and -, at most 31, beginning with a letter or digit"
# What speaks over a computer's own devices, buses and loopback interface.
TOGETHER: tuple[tuple[str, ...], ...] = (
    ("comms_manager", "device_emulators", "hdt_driver", "hdt_bridge"),
    ("operator_station", "operator_stop"),
)


class HostRow(Table):
    """One host of a deployment."""

    address: str  # IPv4, of the interface by which the others reach it
    processes: tuple[str, ...] = ()  # besides bifrostd, which runs on every host


class Deployment(Table, kw_only=True):
    """One such file."""

    description: str
    name: str = ""  # else the file's
    profile: str = "sim"
    agent_port: Annotated[int, Meta(ge=1024, le=65535)] = AGENT_PORT
    hosts: Annotated[dict[str, HostRow], Meta(min_length=1)]
    link: LinkRow | None = None  # between the robot's hosts and the operator's; None: all are one network

    def __post_init__(self) -> None:
        addresses: dict[str, str] = {}
        homes: dict[str, str] = {}
        for name, host in self.hosts.items():
            if not _NAME.fullmatch(name):
                raise TableError(("hosts", name), f"expected {_NAMES}")
            _require_address(("hosts", name, "address"), host.address)
            if host.address in addresses:
                what = f"got {host.address}, which is {addresses[host.address]}'s; expected one of its own"
                raise TableError(("hosts", name, "address"), what)
            addresses[host.address] = name
            for place, process in enumerate(host.processes):
                path = ("hosts", name, "processes", str(place))
                _require_process(path, process, homes)
                homes[process] = name
        _require_together(homes, {name: row.processes for name, row in self.hosts.items()})
        require_apart(self.link, homes, self.hosts)

    @classmethod
    def load(cls, file: Path) -> Deployment:
        """Read a deployment, and hold it against its profile.

        Raises:
            ConfigurationError: names the file, line, key and what was expected.
        """
        from valor.common.document import Document

        deployment = read(cls, file)
        document = Document.load(file)
        try:
            found = profile_file(_beside(file, deployment.profile))
        except ConfigurationError as error:
            raise document.error(("profile",), str(error)) from None
        profile = Profile.load(found)
        for name, row in deployment.hosts.items():
            for place, process in enumerate(row.processes):
                if BY_NAME[process].hardware_only and profile.variant != "hardware":
                    path = ("hosts", name, "processes", str(place))
                    raise document.error(path, f"got {process}, which profile {deployment.profile} cannot have")
        placed = {process for row in deployment.hosts.values() for process in row.processes}
        if missing := [name for name in profile.processes if name not in placed and name != DAEMON]:
            text = f"{', '.join(missing)} of profile {deployment.profile}: expected on one of the hosts"
            raise document.error(("hosts",), text)
        name = deployment.name or file.stem
        if not _NAME.fullmatch(name):
            raise document.error(("name",), f"got {name!r}; expected {_NAMES}")
        return msgspec.structs.replace(deployment, name=name, profile=_beside(file, deployment.profile))

    @property
    def processes(self) -> tuple[str, ...]:
        """All that run, in the table's order."""
        placed = {process for row in self.hosts.values() for process in row.processes}
        return tuple(name for name in BY_NAME if name in placed or name == DAEMON)

    @property
    def operators(self) -> tuple[str, ...]:
        """Hosts behind the link; none: there is no link."""
        return self.link.operators if self.link is not None else ()

    @property
    def link_settings(self) -> Link:
        """Of the link, as the settings of an instance have it before its ROS domain is chosen."""
        if self.link is None:
            return Link()
        home = next(row for row in self.hosts.values() if NAMES[0] in row.processes)
        return self.link.settings(home.address)

    def beside(self, host: str) -> tuple[str, ...]:
        """The hosts of a host's network, itself included."""
        return tuple(name for name in self.hosts if (name in self.operators) == (host in self.operators))

    def table(self, here: str, also: Iterable[str] = (), but: Iterable[str] = ()) -> tuple[Host, ...]:
        """Its hosts as the settings of an instance hold them.

        Args:
            here: the host that `up` is called on: it gets what options ask for and no host has.
            also: processes that options ask for.
            but: processes that options do not want.
        """
        placed, unwanted = set(self.processes), set(but)
        more = tuple(name for name in also if name not in placed)
        return tuple(
            Host(
                name=name,
                address=row.address,
                processes=tuple(
                    each for each in row.processes + (more if name == here else ()) if each not in unwanted
                ),
                operator=name in self.operators,
            )
            for name, row in self.hosts.items()
        )


def deployment_file(name: str) -> Path:
    """The file of a deployment: one of ours by name, or any ``.yaml`` file by its path.

    Raises:
        ConfigurationError: no such deployment; lists those known.
    """
    if name in resources.deployments():
        return resources.deployment_file(name)
    file = Path(name).expanduser()
    if file.suffix == ".yaml" and file.is_file():
        return file.resolve()
    raise ConfigurationError(f"deployment {expected(name, resources.deployments(), 'a .yaml file, or ')}")


def _beside(file: Path, profile: str) -> str:
    """A profile's own name, or its path, which may be relative to the deployment's file."""
    return str((file.parent / profile).resolve()) if profile.endswith(".yaml") else profile


def _require_address(path: tuple[str, ...], address: str) -> None:
    try:
        found = ipaddress.IPv4Address(address)
    except ValueError:
        raise TableError(path, f"got {address!r}; expected an IPv4 address") from None
    if found.is_loopback or found.is_unspecified or found.is_multicast:
        raise TableError(path, f"got {address}; expected an address by which the other hosts reach this one")


def _require_process(path: tuple[str, ...], process: str, homes: Mapping[str, str]) -> None:
    if process not in BY_NAME:
        raise TableError(path, expected(process, BY_NAME))
    if process == DAEMON:
        raise TableError(path, f"got {DAEMON}, which runs on every host; expected the others")
    if process in homes:
        raise TableError(path, f"got {process!r}, which runs on {homes[process]}; expected each process once")


def _require_together(homes: Mapping[str, str], rows: Mapping[str, tuple[str, ...]]) -> None:
    for group in TOGETHER:
        there = [process for process in group if process in homes]
        for process in there[1:]:
            if homes[process] != homes[there[0]]:
                place = rows[homes[process]].index(process)
                what = f"got {process}; expected it on the host of {there[0]}, {homes[there[0]]}"
                raise TableError(("hosts", homes[process], "processes", str(place)), what)
