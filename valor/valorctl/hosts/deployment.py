"""Deployments: files that state on which hosts an instance runs, and each process on which."""

import hashlib
import ipaddress
import re
import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Self

import msgspec
from msgspec import Meta

from valor.common.errors import ConfigurationError, expected
from valor.common.instance import LINK_RATE, Host, Link, LinkRate, SshSettings, WhenLost
from valor.common.linking import NAMES
from valor.common.processes import BY_NAME, DAEMON
from valor.common.resources import file_of
from valor.common.table import Positive, Table, TableError, read
from valor.valorctl.instance.profile import Profile
from valor.valorctl.instance.ros_domain import DOMAINS

LINK_PORT = 7312  # UDP; below Linux' ephemeral ports
_NAME = re.compile(r"[a-z0-9][a-z0-9-]{0,30}")
_NAMES = "lower-case letters, digits and -, at most 31, beginning with a letter or digit"
_DESTINATION = re.compile(r"[^-\s]\S*")
_RELAY = "ADDRESS:PORT, 10.77.0.9:9000"
_SECRET = 32  # least length of the link's key [B]
# Processes that use one computer's devices, buses or loopback interface.
TOGETHER: tuple[tuple[str, ...], ...] = (
    ("comms_manager", "device_emulators", "hdt_driver", "hdt_bridge"),
    ("operator_station", "operator_stop"),
)
OPERATORS = ("link_operator", "operator_station", "operator_stop", "foxglove_bridge")
"""Processes that can run in the operator's network: all others are part of the robot, or use Bifrost with it."""


class LinkRow(Table, kw_only=True):
    """The link between the robot's network and the operator's."""

    operators: Annotated[tuple[str, ...], Meta(min_length=1)]  # hosts of the operator's network; others: the robot's
    domain: Annotated[int, Meta(ge=DOMAINS[0], le=DOMAINS[-1])] | None = None  # ROS domain there; None: a free one
    address: str = ""  # of link_robot's host in the operator's network; empty: the host's
    relay: str = ""  # ADDRESS:PORT of what is in between, UDP; the fast channel uses the port after it
    key: str = ""  # file with the secret of both ends, beside the deployment's; empty: NAME.key
    on_operator_lost: WhenLost = "go_on"
    operator_timeout: Positive = 10.0  # [s]
    # UDP port of link_robot's slow channel; the fast one uses the port after it.
    port: Annotated[int, Meta(ge=1024, lt=65535)] = LINK_PORT
    rate: LinkRate = LINK_RATE  # of the slow channel, in both directions together [B/s]
    picture: str = Link().picture  # topic of the robot's view, sensor_msgs/CompressedImage
    # Names until version 0.4.
    through: str = ""
    when_lost: WhenLost | None = None
    lost_after: Positive | None = None

    def __post_init__(self) -> None:
        if self.address:
            _require_ipv4(("address",), self.address)
        for name in ("relay", "through"):
            if relay := getattr(self, name):
                address, _, port = relay.rpartition(":")
                _require_ipv4((name,), address, relay, _RELAY)
                valid = port.isascii() and port.isdigit() and 0 < int(port) < 65535
                _require(valid, (name,), f"got {relay!r}; expected {_RELAY}")

    def settings(self, robot: str) -> Link:
        """Settings of an instance before its ROS domain is chosen; ``robot``: address of link_robot's host."""
        listen = self.address or robot
        address, _, port = (self.relay or self.through).rpartition(":")
        slow = int(port) if port else self.port
        return Link(
            domain=self.domain,
            when_lost=self.when_lost or self.on_operator_lost,
            lost_after=self.lost_after or self.operator_timeout,
            listen=listen,
            port=self.port,
            robot=address or listen,
            slow=slow,
            fast=slow + 1,
            rate=self.rate,
            picture=self.picture,
        )


class HostRow(Table):
    """One host of a deployment."""

    address: str  # IPv4, of the interface through which the others reach it
    ssh: str = ""  # destination as ssh accepts it; empty: the address
    processes: tuple[str, ...] = ()  # in addition to bifrostd, which runs on every host


class Deployment(Table, kw_only=True):
    """A deployment file."""

    description: str
    name: str = ""  # empty: the file's
    profile: str = "sim"
    ssh: SshSettings = SshSettings()
    hosts: Annotated[dict[str, HostRow], Meta(min_length=1)]
    link: LinkRow | None = None  # None: all hosts are one network

    def __post_init__(self) -> None:
        addresses: dict[str, str] = {}
        homes: dict[str, tuple[str, ...]] = {}  # by process: where the file names it
        for name, host in self.hosts.items():
            path: tuple[str, ...] = ("hosts", name)
            _require(_NAME.fullmatch(name), path, f"expected {_NAMES}")
            _require_ipv4((*path, "address"), host.address, reachable=True)
            _require(
                not host.ssh or _DESTINATION.fullmatch(host.ssh),
                (*path, "ssh"),
                f"got {host.ssh!r}; expected a destination of ssh: motion, robot@motion, ssh://robot@motion:2222",
            )
            other = addresses.setdefault(host.address, name)
            what = f"got {host.address}, the address of {other}; expected another one"
            _require(other == name, (*path, "address"), what)
            for index, process in enumerate(host.processes):
                path = ("hosts", name, "processes", str(index))
                _require(process in (*BY_NAME, *homes), path, expected(process, BY_NAME))
                _require(process != DAEMON, path, f"got {DAEMON}, which runs on every host; expected the others")
                first = homes.setdefault(process, path)
                _require(first == path, path, f"got {process!r}, which runs on {first[1]}; expected each process once")
        for group in TOGETHER:
            paths = [(process, homes[process]) for process in group if process in homes]
            for process, path in paths[1:]:
                what = f"got {process}; expected it on the host of {paths[0][0]}, {paths[0][1][1]}"
                _require(path[1] == paths[0][1][1], path, what)
        _require_sides(self.link, homes, self.hosts)

    @classmethod
    def load(cls, file: Path) -> Self:
        """Read a deployment, and check it against its profile. Raises ``ConfigurationError``."""
        from valor.common.document import Document

        deployment, document = read(cls, file), Document.load(file)
        name, link, ssh = deployment.name or file.stem, deployment.link, deployment.ssh
        profile_name = deployment.profile
        if profile_name.endswith(".yaml"):
            profile_name = str((file.parent / profile_name).resolve())
        try:
            profile = Profile.load(file_of("profile", profile_name))
        except ConfigurationError as error:
            raise document.error(("profile",), str(error)) from None
        for host, row in deployment.hosts.items():
            for index, process in enumerate(row.processes):
                if BY_NAME[process].hardware_only and profile.variant != "hardware":
                    path = ("hosts", host, "processes", str(index))
                    raise document.error(path, f"got {process}, which profile {deployment.profile} cannot have")
        if missing := [process for process in profile.processes if process not in deployment.processes]:
            text = f"{', '.join(missing)} of profile {deployment.profile}: expected on one of the hosts"
            raise document.error(("hosts",), text)
        if not _NAME.fullmatch(name):
            raise document.error(("name",), f"got {name!r}; expected {_NAMES}")
        if ssh.config:
            ssh = msgspec.structs.replace(ssh, config=str(file.parent / Path(ssh.config).expanduser()))
            if not Path(ssh.config).exists():
                text = f"{ssh.config}: no such file; expected one in ssh_config's format"
                raise document.error(("ssh", "config"), text)
        if link is not None:
            link = msgspec.structs.replace(link, key=str(file.parent / Path(link.key or f"{name}.key").expanduser()))
        return msgspec.structs.replace(deployment, name=name, profile=profile_name, ssh=ssh, link=link)

    @property
    def processes(self) -> tuple[str, ...]:
        """All processes, in the order of ``PROCESSES``."""
        placed = {process for row in self.hosts.values() for process in row.processes}
        return tuple(name for name in BY_NAME if name in placed or name == DAEMON)

    @property
    def operators(self) -> tuple[str, ...]:
        """Hosts of the operator's network; empty if there is no link."""
        return self.link.operators if self.link is not None else ()

    @property
    def link_settings(self) -> Link:
        """Settings of the link, before its ROS domain is chosen."""
        if self.link is None:
            return Link()
        home = next(row for row in self.hosts.values() if NAMES[0] in row.processes)
        return self.link.settings(home.address)

    def link_secret(self, instance: str) -> bytes | None:
        """The secret of both ends, from their key file; None: no link. Raises ``ConfigurationError`` about the file."""
        if self.link is None:
            return None
        file = Path(self.link.key)
        words = shlex.quote(str(file))
        advice = f"make one, and copy it to a host of each side: (umask 077; head -c {_SECRET} /dev/urandom > {words})"
        try:
            key, mode = file.read_bytes(), file.stat().st_mode
        except OSError as error:
            raise ConfigurationError(f"{file}: {error.strerror}; expected the link's key; {advice}") from None
        if mode & 0o077:
            raise ConfigurationError(f"{file}: mode {mode & 0o777:04o}; expected 0600: chmod 600 {words}")
        if len(key) < _SECRET:
            raise ConfigurationError(f"{file}: {len(key)} bytes; expected at least {_SECRET}; {advice}")
        return hashlib.blake2b(key, person=instance.encode()[:16], digest_size=32).digest()

    def table(self, here: str, also: Iterable[str] = (), but: Iterable[str] = ()) -> tuple[Host, ...]:
        """The hosts for an instance: ``also`` run here, where `up` is called, if on no host; ``but`` run nowhere."""
        placed, unwanted, table = set(self.processes), set(but), []
        more = tuple(name for name in also if name not in placed)
        for name, row in self.hosts.items():
            wanted = row.processes + (more if name == here else ())
            processes = tuple(each for each in wanted if each not in unwanted)
            operator = name in self.operators
            table.append(Host(name=name, address=row.address, ssh=row.ssh, processes=processes, operator=operator))
        return tuple(table)


def _require(valid: object, path: tuple[str, ...], text: str) -> None:
    if not valid:
        raise TableError(path, text)


def _require_ipv4(
    path: tuple[str, ...], address: str, shown: str = "", what: str = "an IPv4 address", reachable: bool = False
) -> None:
    try:
        found = ipaddress.IPv4Address(address)
    except ValueError:
        raise TableError(path, f"got {shown or address!r}; expected {what}") from None
    local = found.is_loopback or found.is_unspecified or found.is_multicast
    what = f"got {address}; expected an address through which the other hosts reach this one"
    _require(not (reachable and local), path, what)


def _require_sides(link: LinkRow | None, homes: Mapping[str, tuple[str, ...]], rows: Mapping[str, HostRow]) -> None:
    if link is None:
        for name in NAMES:
            _require(name not in homes, homes.get(name, ()), f"got {name}; expected with `link:`, or not at all")
        return
    for index, host in enumerate(link.operators):
        _require(host in rows, ("link", "operators", str(index)), expected(host, rows))
    for name in NAMES:
        _require(name in homes, ("link",), f"expected {name} on one of the hosts")
    for process, path in homes.items():
        operators = path[1] in link.operators
        what = f"got {process}, on a host of link.operators; expected there only {', '.join(OPERATORS)}"
        _require(process in OPERATORS or not operators, path, what)
        what = f"got {process}, on a host of the robot; expected it on one of link.operators"
        _require(process != NAMES[1] or operators, path, what)
