"""Choice and reservation of an instance's ROS domain, and of the ports that belong to it.

A domain is reserved by a socket of its name in Linux' abstract namespace: visible to every user, without a file, and
removed by the kernel at the end of the last process that holds it. ``valorctl up`` creates the socket, and supervisord
inherits it. The namespace is per network namespace, as are the ports that a domain determines: those of discovery, of
the CAN buses between devices and their emulators, and of the Bifrost daemon.
"""

import contextlib
import errno
import hashlib
import json
import re
import socket
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from valor.common.errors import ConfigurationError, ValorError
from valor.common.instance import Instance
from valor.common.resources import middleware_profile

DOMAINS = range(1, 102)
"""ROS domains with ports below Linux' ephemeral ports; 0 is the default of every ROS program."""

_DAEMON_PORTS = 120  # TCP ports per domain, from 20000 on


class Reservation(socket.socket):
    """Socket that reserves a domain. Closed here and in every process that inherited it, the domain is free again."""

    domain: int  # the reserved domain


def reserve(key: str, but: Collection[int] = ()) -> Reservation:
    """Reserve a domain, except those of ``but``; ``key`` and errors as of ``choose``."""
    while True:
        domain = choose(key, but, lambda each: not is_reserved(each) and is_free(each))
        if (holder := _hold(domain)) is not None:
            return holder


def reserve_for(instance: Instance, wanted: int | None = None) -> Reservation:
    """Reserve a domain for an instance: the wanted one, or another if ROS programs use that, which then share it."""
    others = taken(instance.folder.parent, but=instance)
    if wanted is None:
        return reserve(str(instance.folder), others)
    if wanted in DOMAINS and wanted not in others and is_free(wanted) and (holder := _hold(wanted)):
        return holder
    return reserve(str(instance.folder), others | {wanted})


def retake(domain: int) -> Reservation:
    """Reserve the domain of an instance whose processes ended; raises ``ValorError`` if another instance has it."""
    if (holder := _hold(domain)) is None:
        raise ValorError(f"ROS domain {domain} is another instance's")
    return holder


def refuse_namesake(instance: Instance, domain: int, namespace: str) -> None:
    """Raise ``ValorError`` if another instance of the home has both the domain and the namespace."""
    for file, settings in _settings(instance.folder.parent):
        same = (settings.get("ros_domain_id"), settings.get("namespace", "")) == (domain, namespace)
        if same and file != instance.settings_file:
            where = f"namespace {namespace!r}" if namespace else "no namespace"
            what = f"ROS domain {domain} has instance {file.parent.name!r} with {where}, too"
            raise ValorError(f"{what}; expected another --namespace, or another --domain")


def choose(key: str, taken: Collection[int], is_free: Callable[[int], bool]) -> int:
    """A free ROS domain; ``key`` determines the start of the search. Raises ``ValorError``: all are in use."""
    start = int.from_bytes(hashlib.sha256(key.encode()).digest()[:4], "big") % len(DOMAINS)
    for offset in range(len(DOMAINS)):
        domain = DOMAINS[(start + offset) % len(DOMAINS)]
        if domain not in taken and is_free(domain):
            return domain
    raise ValorError(f"no free ROS domain: {DOMAINS[0]} to {DOMAINS[-1]} are all in use on this computer")


def discovery_port(domain: int) -> int:
    """UDP port of the first participant of a domain (DDSI-RTPS 2.2, 9.6.1.1: 7400 + 250·d + 10)."""
    return 7410 + 250 * domain


def daemon_ports(domain: int) -> range:
    """TCP ports for the Bifrost daemon of a domain's instance, below Linux' ephemeral ports."""
    return range(20000 + _DAEMON_PORTS * domain, 20000 + _DAEMON_PORTS * (domain + 1))


def is_free(domain: int) -> bool:
    """Return whether no participant of the domain runs on this computer."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", discovery_port(domain)))
        except OSError:
            return False
    return True


def is_reserved(domain: int) -> bool:
    """Return whether an instance of any home has the domain."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(_name(domain))
        except ConnectionRefusedError:  # no socket has the name
            return False
    return True


def taken(home: Path, but: Instance | None = None) -> set[int]:
    """ROS domains in the settings of a home's instances, except of one; also without a running supervisord."""
    found: set[int] = set()
    for file, settings in _settings(home):
        if but is None or file != but.settings_file:
            numbers = (settings.get("ros_domain_id"), settings.get("port_block"))
            found.update(number for number in numbers if isinstance(number, int) and number)
    return found


def _settings(home: Path) -> Iterator[tuple[Path, dict[str, Any]]]:
    for file in sorted(home.glob("*/instance.json")):
        with contextlib.suppress(OSError, ValueError):
            if isinstance(settings := json.loads(file.read_text()), dict):
                yield file, settings


def _hold(domain: int) -> Reservation | None:  # None: another process holds it
    holder = Reservation(socket.AF_UNIX, socket.SOCK_DGRAM)
    holder.domain = domain
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


LOOPBACK = "127.0.0.1"
PARTICIPANTS = 32  # ROS processes of a computer that are discovered; each has a port, from the domain's first
_HOST = re.compile(r"[A-Za-z0-9](?:[A-Za-z0-9.-]{0,252})")
_NAMESPACE = "http://www.eprosima.com"


def addresses(peers: Sequence[str]) -> tuple[str, ...]:
    """IPv4 addresses of computers; raises ``ConfigurationError`` with the invalid or unreachable one."""
    found: list[str] = []
    for peer in peers:
        if not _HOST.fullmatch(peer):
            raise ConfigurationError(f"--peers {peer[:64]!r}: expected a computer's name or IPv4 address")
        try:
            address = socket.gethostbyname(peer)
        except OSError as error:
            raise ConfigurationError(f"--peers {peer}: {error.strerror or error}") from None
        if address.startswith("127."):
            raise ConfigurationError(f"--peers {peer}: is this computer ({address}); expected others")
        interface(address)
        if address not in found:
            found.append(address)
    return tuple(found)


def interface(peer: str) -> str:
    """This computer's address on the route to a peer; raises ``ConfigurationError`` without a route."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((peer, 9))  # sends nothing
        except OSError as error:
            raise ConfigurationError(f"--peers {peer}: is not reached from here: {error.strerror}") from None
        return str(probe.getsockname()[0])


def peers_profile(peers: Collection[str]) -> str:
    """Fast DDS' configuration (XML) for IPv4 addresses; raises ``ConfigurationError`` without a route to one.

    ``deploy/fastdds.xml`` keeps ROS 2 on the loopback interface. For peers, the interfaces towards them are added, and
    this computer announces itself by unicast, for networks without multicast. The peers only need the same ROS domain.
    """
    ElementTree.register_namespace("", _NAMESPACE)
    root = ElementTree.parse(middleware_profile()).getroot()
    transport, participant = (_one(root, name) for name in ("transport_descriptor", "rtps"))
    allowed = _one(transport, "interfaceWhiteList")
    for address in sorted({interface(peer) for peer in peers}):
        ElementTree.SubElement(allowed, _tag("address")).text = address
    ElementTree.SubElement(transport, _tag("maxInitialPeersRange")).text = str(PARTICIPANTS)
    builtin = ElementTree.SubElement(participant, _tag("builtin"))
    locators = ElementTree.SubElement(builtin, _tag("initialPeersList"))
    for peer in (LOOPBACK, *peers):
        locator = ElementTree.SubElement(ElementTree.SubElement(locators, _tag("locator")), _tag("udpv4"))
        ElementTree.SubElement(locator, _tag("address")).text = peer
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _tag(name: str) -> str:
    return f"{{{_NAMESPACE}}}{name}"


def _one(where: ElementTree.Element, name: str) -> ElementTree.Element:
    found = where.find(f".//{_tag(name)}")
    assert found is not None, name
    return found
