"""Where the ends of the link meet: UDP, on ports that follow from the robot's block."""

from __future__ import annotations

from valor.common.errors import ConfigurationError
from valor.common.instance import Link, Settings, WhenLost

FIRST_PORT = 8400
NAMES = ("link_robot", "link_operator")


def ports(block: int) -> tuple[int, int]:
    """Of the robot's end of the instance with this block: of the slow channel and of the fast one."""
    return FIRST_PORT + 2 * block, FIRST_PORT + 2 * block + 1


def robot_ports(settings: Settings) -> tuple[int, int]:
    """Where the robot's end listens: as settings on its side have it."""
    port = settings.link.port
    return (port, port + 1) if port else ports(settings.block)


def ports_to_robot(settings: Settings) -> tuple[int, int]:
    """By which the operator's end reaches it: whatever stands between, or itself."""
    slow, fast = robot_ports(settings)
    return settings.link.slow or slow, settings.link.fast or fast


def behind(settings: Settings) -> bool:
    """Whether the operator's programs of this computer have the robot through the link."""
    here = next((host for host in settings.hosts if host.name == settings.here), None)
    return settings.link.domain is not None and (here is None or here.operator)


def robots_hosts(settings: Settings) -> tuple[str, ...]:
    """The hosts of the robot's network, where this computer is one of the operator's: Bifrost does not reach them."""
    here = next((host for host in settings.hosts if host.name == settings.here), None)
    return (
        tuple(host.name for host in settings.hosts if not host.operator) if here is not None and here.operator else ()
    )


def beyond(settings: Settings, process: str) -> bool:
    """Whether a process runs on the robot's side of the link, and this computer is on the operator's."""
    robots = robots_hosts(settings)
    return any(process in each.processes for each in settings.hosts if each.name in robots)


def parsed(text: str | None, when_lost: WhenLost) -> Link:
    """``DOMAIN[:PORT]`` as settings have it: the fast channel has the port after PORT.

    Raises:
        ConfigurationError: it is something else.
    """
    if text is None:
        return Link(when_lost=when_lost)
    domain, colon, port = text.partition(":")
    numbers = [int(each) for each in (domain, port if colon else "0") if each.isascii() and each.isdigit()]
    if len(numbers) != 2 or not (0 <= numbers[0] <= 232 and 0 <= numbers[1] < 65535):
        raise ConfigurationError(f"--link {text!r}: expected a ROS domain, 0 to 232, and perhaps a port: 77, 77:9000")
    slow = numbers[1]
    return Link(domain=numbers[0], when_lost=when_lost, slow=slow, fast=slow + 1 if slow else 0)
