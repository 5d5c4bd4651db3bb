"""The ROS domain of an instance, and the ports that go with it: ones that nobody on this computer uses.

Whoever takes a domain holds a socket of that name in Linux' abstract namespace, which has no file: every user sees it,
whatever their home, and the kernel takes it away when the last process that holds it ends, however it ends. ``valorctl
up`` takes it and hands it to supervisord. It is per network namespace, as the ports are that a domain stands for: those
of discovery, of the CAN buses between devices and their emulators, and of the Bifrost daemon.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import socket
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any, Self

from valor.common.errors import ValorError
from valor.common.instance import Instance

DOMAINS = range(1, 102)
"""ROS domains whose ports lie below Linux' ephemeral ones; 0 is everybody's."""


_DAEMON_PORTS = 120  # TCP, of each domain, from 20000 on


class Reservation:
    """A domain that nobody else gets, until this is closed here and wherever it was handed to.

    Attributes:
        domain: the domain.
    """

    def __init__(self, domain: int, holder: socket.socket) -> None:
        self.domain = domain
        self._holder = holder

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Give it back, unless somebody inherited it."""
        self._holder.close()

    def fileno(self) -> int:
        """The descriptor that holds it; a process that inherits it holds it, too."""
        return self._holder.fileno()


def reserve(key: str, but: Collection[int] = ()) -> Reservation:
    """Take a domain.

    Args:
        key: of the same one the same domain is tried first.
        but: domains that are not to be had.

    Raises:
        ValorError: all are taken.
    """
    holders: dict[int, socket.socket] = {}

    def take(domain: int) -> bool:
        holder = _hold(domain)
        if holder is None:
            return False
        if not is_free(domain):  # a ROS system that is none of ours
            holder.close()
            return False
        holders[domain] = holder
        return True

    domain = choose(key, but, take)
    return Reservation(domain, holders[domain])


def reserve_for(instance: Instance, wanted: int | None = None) -> Reservation:
    """Take a domain for an instance: the one that it wants, or where somebody is in it already, another.

    What goes with the domain that is taken is the instance's alone; the domain wanted it then shares.

    Raises:
        ValorError: all are taken.
    """
    others = taken(instance.folder.parent, but=instance)
    if wanted is None:
        return reserve(str(instance.folder), others)
    if wanted in DOMAINS and wanted not in others and is_free(wanted) and (holder := _hold(wanted)):
        return Reservation(wanted, holder)
    return reserve(str(instance.folder), others | {wanted})


def retake(domain: int) -> Reservation:
    """Take the domain that an instance had when its processes ended, whoever of ROS is in it: its clients may go on.

    Raises:
        ValorError: another instance has it.
    """
    if (holder := _hold(domain)) is None:
        raise ValorError(f"ROS domain {domain} is another instance's")
    return Reservation(domain, holder)


def refuse_namesake(instance: Instance, domain: int, namespace: str) -> None:
    """See that no other instance of the home has the domain and the namespace, too.

    Raises:
        ValorError: names it.
    """
    for file, settings in _settings(instance.folder.parent):
        if file == instance.settings_file or settings.get("ros_domain_id") != domain:
            continue
        if settings.get("namespace", "") == namespace:
            where = f"namespace {namespace!r}" if namespace else "no namespace"
            raise ValorError(
                f"ROS domain {domain} has instance {file.parent.name!r} with {where}, too; "
                "expected another --namespace, or another --domain"
            )


def choose(key: str, taken: Collection[int], is_free: Callable[[int], bool]) -> int:
    """A ROS domain that nobody uses; the search begins at a place that depends on ``key`` alone.

    Raises:
        ValorError: all are taken.
    """
    start = int.from_bytes(hashlib.sha256(key.encode()).digest()[:4], "big") % len(DOMAINS)
    for offset in range(len(DOMAINS)):
        domain = DOMAINS[(start + offset) % len(DOMAINS)]
        if domain not in taken and is_free(domain):
            return domain
    raise ValorError(f"no free ROS domain: {DOMAINS[0]} to {DOMAINS[-1]} are all in use on this computer")


def discovery_port(domain: int) -> int:
    """The UDP port that the first participant of a domain listens on (DDSI-RTPS 2.2, 9.6.1.1: 7400 + 250·d + 10)."""
    return 7410 + 250 * domain


def daemon_ports(domain: int) -> range:
    """The TCP ports of which the Bifrost daemon of a domain's instance gets one; below Linux' ephemeral ones."""
    return range(20000 + _DAEMON_PORTS * domain, 20000 + _DAEMON_PORTS * (domain + 1))


def is_free(domain: int) -> bool:
    """Whether no participant of the domain runs on this computer."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", discovery_port(domain)))
        except OSError:
            return False
    return True


def is_reserved(domain: int) -> bool:
    """Whether an instance of whatever home has the domain."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(_name(domain))
        except ConnectionRefusedError:  # nobody has that name
            return False
    return True


def taken(home: Path, but: Instance | None = None) -> set[int]:
    """The ROS domains of the instances under a home, but of one; also of those whose supervisord was killed."""
    found: set[int] = set()
    for file, settings in _settings(home):
        if but is None or file != but.settings_file:
            numbers = (settings.get("ros_domain_id"), settings.get("port_block"))
            found.update(number for number in numbers if isinstance(number, int) and number)
    return found


def _settings(home: Path) -> Iterator[tuple[Path, dict[str, Any]]]:
    """Of the instances under a home, as far as they can be read."""
    for file in sorted(home.glob("*/instance.json")):
        with contextlib.suppress(OSError, ValueError):
            if isinstance(settings := json.loads(file.read_text()), dict):
                yield file, settings


def _hold(domain: int) -> socket.socket | None:
    """The socket that holds a domain; None: another one does."""
    holder = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        holder.bind(_name(domain))
    except OSError as error:
        holder.close()
        if error.errno != errno.EADDRINUSE:
            raise
        return None
    return holder


def _name(domain: int) -> str:
    return f"\0valor/ros_domain/{domain}"
