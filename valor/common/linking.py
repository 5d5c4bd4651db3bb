"""Addresses and sides of the link: UDP, on ports derived from the robot's port block."""

from valor.common.errors import ConfigurationError
from valor.common.instance import LEAST_LINK_RATE, LINK_RATE, Link, Settings, WhenLost

FIRST_PORT = 8400
NAMES = ("link_robot", "link_operator")
PICTURE = "link/picture/compressed"  # sensor_msgs/CompressedImage, in the operator's ROS domain


def ports(block: int) -> tuple[int, int]:
    """UDP ports of the robot's end for a port block: slow and fast channel."""
    return FIRST_PORT + 2 * block, FIRST_PORT + 2 * block + 1


def robot_ports(settings: Settings) -> tuple[int, int]:
    """UDP ports on which the robot's end listens."""
    port = settings.link.port
    return (port, port + 1) if port else ports(settings.block)


def ports_to_robot(settings: Settings) -> tuple[int, int]:
    """UDP ports to which the operator's end sends: of a relay, or of the robot's end."""
    slow, fast = robot_ports(settings)
    return settings.link.slow or slow, settings.link.fast or fast


def behind(settings: Settings) -> bool:
    """Return whether the operator's programs on this host reach the robot through the link."""
    here = next((host for host in settings.hosts if host.name == settings.here), None)
    return settings.link.domain is not None and (here is None or here.operator)


def robots_hosts(settings: Settings) -> tuple[str, ...]:
    """Hosts of the robot's network, which Bifrost does not reach, if this host is one of the operator's; else none."""
    here = next((host for host in settings.hosts if host.name == settings.here), None)
    if here is None or not here.operator:
        return ()
    return tuple(host.name for host in settings.hosts if not host.operator)


def require_local(settings: Settings, process: str, verb: str) -> None:
    """Raise ConfigurationError, with the command to run instead, for a process on the robot's side of the link."""
    robots = robots_hosts(settings)
    host = next((each.name for each in settings.hosts if each.name in robots and process in each.processes), None)
    if host is not None:
        raise ConfigurationError(
            f"{process} runs on {host}, on the robot's side of the link: `ssh {host} valorctl {verb} {process}`"
        )


def robot_side_advice(settings: Settings) -> str:
    """How to reach the robot's side from one of the operator's hosts; empty on any other host."""
    robots = robots_hosts(settings)
    return f"robot's side: on {' or '.join(robots)}, by ssh: `valorctl status`, `valorctl down`" if robots else ""


def parsed(text: str | None, when_lost: WhenLost) -> Link:
    """Settings for ``DOMAIN[:PORT][@RATE]``; PORT + 1 is the fast channel. Raises ConfigurationError if malformed."""
    if text is None:
        return Link(when_lost=when_lost)
    (ends, at, rate), least = text.partition("@"), LEAST_LINK_RATE
    domain, colon, port = ends.partition(":")
    given = (domain, port if colon else "0", rate if at else f"{LINK_RATE:.0f}")
    numbers = [int(each) for each in given if each.isascii() and each.isdigit()]
    if len(numbers) != 3 or not (0 <= numbers[0] <= 232 and 0 <= numbers[1] < 65535 and numbers[2] >= least):
        raise ConfigurationError(
            f"--link {text!r}: expected DOMAIN[:PORT][@RATE], such as 77 or 77:9000@800, with DOMAIN from 0 to 232 and "
            f"RATE from {least:.0f} B/s: below it, commands and stops are late"
        )
    slow = numbers[1]
    return Link(domain=numbers[0], when_lost=when_lost, slow=slow, fast=slow + 1 if slow else 0, rate=numbers[2])
