"""``link:`` of a deployment: which hosts are the operator's, and how the ends of the link reach each other."""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping
from typing import Annotated, Protocol

from msgspec import Meta

from valor.common.errors import expected
from valor.common.instance import Link, WhenLost
from valor.common.linking import NAMES
from valor.common.table import Positive, Table, TableError
from valor.valorctl.ros_domain import DOMAINS

OPERATORS = ("link_operator", "operator_station", "foxglove_bridge")
"""What can run in the operator's network: all else is part of the robot, or speaks Bifrost with it."""
LINK_PORT = 7312  # behind the agents'


class LinkRow(Table, kw_only=True):
    """The link between the robot's network and the operator's."""

    operators: Annotated[tuple[str, ...], Meta(min_length=1)]  # hosts of the operator's network; others: the robot's
    domain: Annotated[int, Meta(ge=DOMAINS[0], le=DOMAINS[-1])] | None = None  # of ROS there; None: one that is free
    address: str = ""  # of link_robot's host, as the operator's network reaches it; empty: the host's
    through: str = ""  # ADDRESS:PORT of what stands between, UDP; the fast channel has the port after it
    when_lost: WhenLost = "go_on"
    lost_after: Positive = 10.0  # [s]
    # UDP, of link_robot: the slow channel's; the fast one has the port after it.
    port: Annotated[int, Meta(ge=1024, lt=65535)] = LINK_PORT
    picture: str = Link().picture  # the topic of the robot's view, sensor_msgs/CompressedImage

    def __post_init__(self) -> None:
        if self.address:
            _require_ipv4(("address",), self.address)
        if self.through:
            address, _, port = self.through.rpartition(":")
            _require_ipv4(("through",), address, self.through)
            if not (port.isascii() and port.isdigit() and 0 < int(port) < 65535):
                raise TableError(("through",), f"got {self.through!r}; expected ADDRESS:PORT, 10.77.0.9:9000")

    def settings(self, robot: str) -> Link:
        """As the settings of an instance have it before its ROS domain is chosen; ``robot``: link_robot's host."""
        listen = self.address or robot
        address, _, port = self.through.rpartition(":")
        slow = int(port) if port else self.port
        return Link(
            domain=self.domain, when_lost=self.when_lost, lost_after=self.lost_after,
            listen=listen, port=self.port, robot=address or listen, slow=slow, fast=slow + 1,
            picture=self.picture,
        )  # fmt: skip


class _Row(Protocol):
    @property
    def processes(self) -> tuple[str, ...]: ...


def require_apart(link: LinkRow | None, homes: Mapping[str, str], rows: Mapping[str, _Row]) -> None:
    """See that each end of the link, and everything else, is on its side.

    Args:
        link: as the file has it; None: there is none.
        homes: the host of each process.
        rows: the hosts.

    Raises:
        TableError: names what is not.
    """
    if link is None:
        for name in NAMES:
            if name in homes:
                raise TableError(_path(name, homes, rows), f"got {name}; expected with `link:`, or not at all")
        return
    for place, host in enumerate(link.operators):
        if host not in rows:
            raise TableError(("link", "operators", str(place)), expected(host, rows))
    for name in NAMES:
        if name not in homes:
            raise TableError(("link",), f"expected {name} on one of the hosts")
    for process, host in homes.items():
        operators = host in link.operators
        if process == NAMES[0] and operators:
            what = f"got {process}, on a host of link.operators; expected it on one of the robot's"
        elif process == NAMES[1] and not operators:
            what = f"got {process}, on a host of the robot; expected it on one of link.operators"
        elif operators and process not in OPERATORS:
            what = f"got {process}, on a host of link.operators; expected there {', '.join(OPERATORS)} alone"
        else:
            continue
        raise TableError(_path(process, homes, rows), what)


def _path(process: str, homes: Mapping[str, str], rows: Mapping[str, _Row]) -> tuple[str, ...]:
    return ("hosts", homes[process], "processes", str(rows[homes[process]].processes.index(process)))


def _require_ipv4(path: tuple[str, ...], address: str, shown: str = "") -> None:
    try:
        ipaddress.IPv4Address(address)
    except ValueError:
        what = "ADDRESS:PORT, 10.77.0.9:9000" if shown else "an IPv4 address"
        raise TableError(path, f"got {shown or address!r}; expected {what}") from None
