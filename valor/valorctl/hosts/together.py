"""``up`` and ``down`` of an instance on several hosts: those of this computer's network, where there is a link."""

from __future__ import annotations

import contextlib
import tempfile
import time
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec

import bifrost
from bifrost.network import Computer
from valor.common import membership
from valor.common.errors import ValorError
from valor.common.instance import Instance, Settings
from valor.common.linking import robots_hosts
from valor.common.processes import BY_NAME, DAEMON
from valor.valorctl import instance_setup, ros_domain, shutdown, startup, viewing
from valor.valorctl.console import Progress
from valor.valorctl.health import Listener
from valor.valorctl.hosts.agent import order
from valor.valorctl.hosts.channel import HostError
from valor.valorctl.hosts.credentials import Credentials
from valor.valorctl.hosts.deployment import Deployment, deployment_file
from valor.valorctl.hosts.fleet import Fleet, require
from valor.valorctl.hosts.versions import Versions, differences, known_as
from valor.valorctl.interruption import Interruption

MAKING = 60.0  # a host's folder, supervisord and bifrostd [s]
DOWN = max(process.stop_timeout for process in BY_NAME.values()) + shutdown.MARGIN + 10.0  # [s]


def bring_up(
    instance: Instance, plan: instance_setup.Plan, here: str, progress: Progress, interruption: Interruption
) -> Settings:
    """Bring an instance up on all hosts of this one's network.

    Args:
        instance: by name the same on all.
        plan: with the hosts.
        here: the host that this computer is.
        progress: is told how it goes.
        interruption: ends it.

    Returns:
        The settings that it runs with here.

    Raises:
        ValorError: a host does not answer, has other versions, or did not come up; then nothing of it is left on any.
    """
    began = time.monotonic()
    wanted = msgspec.structs.replace(plan.settings, robot=Path(known_as(plan.settings.robot)), here=here)
    with Fleet(instance, wanted) as fleet:
        progress.waiting("asking the hosts")
        require_same(fleet, wanted)
        domain = _common_domain(fleet, instance, wanted, plan.ros_domain)
        interruption.check()
        behind = bool(robots_hosts(wanted))
        link = msgspec.structs.replace(wanted.link, domain=domain) if behind else wanted.link
        orders = _orders(instance, msgspec.structs.replace(wanted, link=link), domain)
        progress.waiting("making the instance on every host")
        asked = {host: {"instance": instance.name, "order": told} for host, told in orders.items()}
        made = fleet.switchboard.ask("make", asked, timeout=MAKING)
        with _or_down(fleet, [name for name, answer in made.items() if not isinstance(answer, HostError)], progress):
            require(made)
            names = ", ".join(orders)
            progress.done(f"{DAEMON} ready on {names} ({time.monotonic() - began:.1f} s)")
            if plan.viewing is not None:
                viewing.decide(instance, plan.viewing)
            processes = [process for process in plan.profile.table if process.name in wanted.near]
            with Listener(instance, [process.name for process in processes]) as listener:
                startup.start(fleet, listener, processes, progress=progress, interruption=interruption)
            if plan.initial_mode is not None and not behind:
                startup.enter_initial_mode(instance, fleet, plan.initial_mode, progress, interruption)
    return instance.settings()


def take_down(instance: Instance, settings: Settings) -> tuple[bool, list[str]]:
    """Take an instance down on all hosts of this one's network that answer.

    Args:
        instance: by name the same on all.
        settings: with the hosts.

    Returns:
        Whether there was anything, and a line for each host of which it is not known.
    """
    with Fleet(instance, settings) as fleet:
        answers = _down(fleet, [host.name for host in settings.beside(settings.here)])
        problems = [fleet.told(name, each) for name, each in answers.items() if isinstance(each, HostError)]
    return any(answer is True for answer in answers.values()), problems


def deployed(instance: Instance, name: str) -> tuple[Deployment, str]:
    """A deployment, by name or file, and which of its hosts this computer is.

    Raises:
        ConfigurationError: no such deployment, or this computer has not joined it as the file has it now.
    """
    found = Deployment.load(deployment_file(name))
    credentials = Credentials.of(instance, found.name)
    here = credentials.network().computer.name
    credentials.require_same(found)
    return found, here


def settings_of(instance: Instance, name: str) -> Settings:
    """What is needed of an instance's settings to speak of its hosts, of a deployment by name or file.

    Raises:
        ConfigurationError: as ``deployed``.
    """
    found, here = deployed(instance, name)
    return Settings(deployment=found.name, hosts=found.table(here), here=here, robot=Path(), ros_domain_id=0)


def require_same(fleet: Fleet, settings: Settings) -> None:
    """See that all hosts of this one's network have the same code and the same robot.

    Raises:
        HostError: names the hosts, and what differs or why one does not answer.
    """
    robot = str(settings.robot)
    asked = {host.name: {"robot": robot} for host in settings.beside(settings.here)}
    answers = fleet.switchboard.ask("versions", asked, timeout=20.0)
    require(answers)
    found = {name: msgspec.convert(answer, Versions) for name, answer in answers.items()}
    here = settings.here
    lines = [
        f"{name}: {'; '.join(differing)}; expected the same as on {here}"
        for name, versions in found.items()
        if (differing := differences(found[here], versions))
    ]
    if lines:
        raise HostError("\n".join(lines))


@contextlib.contextmanager
def _or_down(fleet: Fleet, hosts: Collection[str], progress: Progress) -> Iterator[None]:
    """What is inside, or nothing left of the instance on the hosts where it has been made."""
    try:
        yield
    except BaseException as error:
        progress.clear()
        try:
            require(_down(fleet, hosts))
        except ValorError as second:
            raise ValorError(f"{error}\nand then: {second}") from error
        raise


def _down(fleet: Fleet, hosts: Collection[str]) -> dict[str, Any]:
    return fleet.ask("down", DOWN, hosts)


def _common_domain(fleet: Fleet, instance: Instance, settings: Settings, asked: int | None) -> int:
    """A ROS domain that is free on all hosts of this one's network, and the one that is wanted, if any is.

    Raises:
        ValorError: there is none.
    """
    frees: Mapping[str, Collection[int]] = require(fleet.ask("free_domains", 10.0))
    behind = bool(robots_hosts(settings))
    wanted = settings.link.domain if behind and asked is None else asked
    if wanted is None:
        key = f"{instance.name} behind the link" if behind else instance.name  # another than the robot's, where it can
        return ros_domain.choose(key, (), lambda domain: all(domain in free for free in frees.values()))
    known = f"{ros_domain.DOMAINS[0]} to {ros_domain.DOMAINS[-1]}"
    for name, free in frees.items():
        if wanted not in free:
            raise ValorError(f"ROS domain {wanted}: is in use on {name}; expected another one of {known}")
    return wanted


def _orders(instance: Instance, settings: Settings, domain: int) -> dict[str, dict[str, Any]]:
    """What each host is told to make, with fresh keys for this run."""
    hosts = settings.beside(settings.here)
    computers = [Computer(host.name, host.address, ros_domain.daemon_ports(domain)[0]) for host in hosts]
    home = instance.folder.parent
    home.mkdir(parents=True, exist_ok=True)
    with instance_setup.private_files(), tempfile.TemporaryDirectory(prefix=".making-", dir=home) as folder:
        made = Instance("made", Path(folder))
        charter = membership.charter(made)
        bifrost.Network.create_for(computers, made.network_file, made.keys, charter)
        return {
            host.name: msgspec.to_builtins(order(made, settings, domain, host.name), builtin_types=(bytes,))
            for host in hosts
        }
