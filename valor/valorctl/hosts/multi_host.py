"""``up``, ``down`` and ``doctor`` of an instance on several hosts: those of this computer's network, with a link."""

import contextlib
import secrets
import socket
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec

import bifrost
from bifrost.network import Computer, copy_for, own_key_file
from valor.common import topics
from valor.common.errors import ConfigurationError, ValorError
from valor.common.instance import Instance, Settings
from valor.common.linking import NAMES, robots_hosts
from valor.common.processes import BY_NAME, DAEMON
from valor.common.resources import file_of, robot_folder, robots
from valor.common.table import plain
from valor.valorctl.hosts.deployment import Deployment
from valor.valorctl.hosts.fleet import Fleet
from valor.valorctl.hosts.orders import HostSetup, Survey
from valor.valorctl.hosts.remote import HostError, Order, Reply, execute_all, require
from valor.valorctl.instance import instance_setup, ros_domain, shutdown, startup
from valor.valorctl.instance.checks import Finding
from valor.valorctl.instance.profile import Profile
from valor.valorctl.status.health import Listener
from valor.valorctl.terminal.console import Interruption, Progress

SURVEY = 30.0  # timeout of versions and ROS domains [s]
MAKING = 60.0  # timeout of a host's folder, supervisord and bifrostd [s]
DOWN = max(process.stop_timeout for process in BY_NAME.values()) + shutdown.MARGIN + 10.0  # timeout of `down` [s]
DIAGNOSIS = 120.0  # timeout of `doctor` [s]
CLOCK_TIMEOUT = 3.0  # until this host's bifrostd responds [s]
CLOCK_DIFFERENCE = 0.1  # difference of wall clocks that is a warning [s]


def bring_up(
    instance: Instance,
    plan: instance_setup.Plan,
    deployment: Deployment,
    progress: Progress,
    interruption: Interruption,
) -> Settings:
    """Bring an instance up on all hosts of this one's network; returns the settings on this host.

    Raises ``ValorError``: a host did not come up, or has other versions; then the instance is removed everywhere.
    """
    began = time.monotonic()
    robot = Path(_name_on_all_hosts(plan.settings.robot))
    wanted = msgspec.structs.replace(plan.settings, robot=robot, run=secrets.token_hex(8))
    progress.waiting("comparing the hosts")
    surveys = survey(instance, wanted)
    require_same(surveys, wanted.here)
    domain = _common_domain(surveys, instance, wanted, plan.ros_domain)
    interruption.check()
    located = [
        msgspec.structs.replace(host, folder=surveys[host.name].folder) if host.name in surveys else host
        for host in wanted.hosts
    ]
    behind = bool(robots_hosts(wanted))
    link = msgspec.structs.replace(wanted.link, domain=domain) if behind else wanted.link
    wanted = msgspec.structs.replace(wanted, hosts=tuple(located), link=link)
    setups = _setups(instance, wanted, domain, deployment.link_secret(instance.name))
    orders = {name: Order("make", instance.name, {"setup": setup}) for name, setup in setups.items()}
    progress.waiting("making the instance on every host")
    made = execute_all(wanted, orders, MAKING)
    down = {name: Order("down", instance.name, {}) for name, answer in made.items() if isinstance(answer, Reply)}
    with startup.undone(lambda: require(execute_all(wanted, down, DOWN)), progress):
        require(made)
        progress.done(f"{DAEMON} ready on {', '.join(orders)} ({time.monotonic() - began:.1f} s)")
        processes = [process for process in plan.profile.table if process.name in wanted.near]
        with Fleet(instance, wanted) as fleet, Listener(instance, [process.name for process in processes]) as listener:
            startup.start(fleet, listener, processes, progress=progress, interruption=interruption)
            if plan.initial_mode is not None and not behind:
                startup.enter_initial_mode(instance, fleet, plan.initial_mode, progress, interruption)
    return instance.settings()


def take_down(instance: Instance, settings: Settings) -> tuple[bool, list[str]]:
    """Take an instance down on all reachable hosts; returns whether there was anything, and a line for each other."""
    answers = _order(instance, settings, "down", DOWN)
    problems = [str(answer) for answer in answers.values() if isinstance(answer, HostError)]
    return any(isinstance(answer, Reply) and answer.result for answer in answers.values()), problems


def deployed(name: str) -> tuple[Deployment, str]:
    """A deployment, and which of its hosts this computer is; raises ``ConfigurationError`` if it is none."""
    file = file_of("deployment", name)
    found = Deployment.load(file)
    for host, row in found.hosts.items():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, contextlib.suppress(OSError):
            probe.bind((row.address, 0))
            return found, host
    addresses = ", ".join(f"{row.address} ({host})" for host, row in found.hosts.items())
    raise ConfigurationError(f"{file}: this computer has none of its addresses: {addresses}; run valorctl on a host")


def settings_of(name: str) -> Settings:
    """The part of an instance's settings that names its hosts, of a deployment by name or file."""
    found, here = deployed(name)
    robot = Path(_name_on_all_hosts(robot_folder(Profile.load(file_of("profile", found.profile)).defaults.robot)))
    return Settings(
        deployment=found.name, hosts=found.table(here), here=here, ssh=found.ssh, robot=robot, ros_domain_id=0
    )


def survey(instance: Instance, settings: Settings) -> dict[str, Survey]:
    """Versions, folder and free ROS domains of all hosts of this one's network; raises ``HostError``."""
    answers = require(_order(instance, settings, "survey", SURVEY, robot=_name_on_all_hosts(settings.robot)))
    return {name: msgspec.convert(answer.result, Survey) for name, answer in answers.items()}


def require_same(surveys: Mapping[str, Survey], here: str) -> None:
    """Raise ``HostError`` unless all hosts have the same code and the same robot."""
    local, lines = surveys[here].versions, []
    for host, found in surveys.items():
        if names := sorted(name for name in local if local[name] != found.versions.get(name)):
            lines.append(f"{host}: {', '.join(names)}: expected the same version as on {here}")
    if lines:
        raise HostError("\n".join(lines))


def diagnose(instance: Instance, deployment: str | None, report: Callable[[str], None]) -> list[Finding]:
    """What `doctor` finds on every host of a deployment, else of the instance that is up, and between the hosts."""
    settings = instance.settings() if deployment is None else settings_of(deployment)
    report("versions")
    findings = [_versions(instance, settings), *_clocks(instance)]
    report("the hosts' own checks")
    answers = _order(instance, settings, "doctor", DIAGNOSIS)
    findings.append(_wall_clocks(answers, settings.here))
    for name, answer in answers.items():
        if isinstance(answer, HostError):
            advice = "switch it on, or mend the cable, its ssh server or its keys (docs/deployment.md)"
            findings.append(Finding("host", "fail", str(answer), advice, name))
        else:
            findings += [Finding(**row | {"host": name}) for row in answer.result]
    return findings


def _name_on_all_hosts(robot: Path) -> str:
    """The name of a robot that is part of the product; the folder of any other."""
    return robot.name if robot.name in robots() and robot_folder(robot.name) == robot else str(robot)


def _order(
    instance: Instance, settings: Settings, verb: str, timeout: float, **arguments: Any
) -> dict[str, Reply | HostError]:
    order = Order(verb, instance.name, arguments)
    return execute_all(settings, {host.name: order for host in settings.beside(settings.here)}, timeout)


def _common_domain(surveys: Mapping[str, Survey], instance: Instance, settings: Settings, wanted: int | None) -> int:
    """A ROS domain that is free on all hosts of this one's network; the requested one, if any is."""
    behind = bool(robots_hosts(settings))
    wanted = settings.link.domain if behind and wanted is None else wanted
    if wanted is None:
        key = f"{instance.name} behind the link" if behind else instance.name  # another than the robot's, if possible
        return ros_domain.choose(key, (), lambda domain: all(domain in found.domains for found in surveys.values()))
    for name, found in surveys.items():
        if wanted not in found.domains:
            raise ValorError(f"ROS domain {wanted}: is in use on {name}; expected another one")
    return wanted


def _setups(instance: Instance, settings: Settings, domain: int, secret: bytes | None) -> dict[str, Any]:
    """What each host needs to make its part, with new keys for this run; ``secret``: of the link, if there is one."""
    hosts = settings.beside(settings.here)
    computers = [Computer(host.name, host.address, ros_domain.daemon_ports(domain)[0]) for host in hosts]
    home = instance.folder.parent
    home.mkdir(parents=True, exist_ok=True)
    setups = {}
    with instance_setup.private_files(), tempfile.TemporaryDirectory(prefix=".making-", dir=home) as folder:
        made = Instance("made", Path(folder))
        bifrost.Network.create_for(computers, made.network_file, made.keys, topics.access_policy(made))
        network = made.network_file.read_bytes()
        for host in hosts:
            files = [made.keys / name for name in ("server.key", "client.key")]
            files += [own_key_file(made.owners, owner) for owner in (DAEMON, *host.processes)]
            keys = {str(file.relative_to(made.folder)): file.read_bytes() for file in files if file.exists()}
            if secret is not None and set(NAMES).intersection(host.processes):
                keys[str(made.link_key.relative_to(made.folder))] = secret
            setup = HostSetup(plain(settings), host.name, domain, copy_for(network, host.name), keys)
            setups[host.name] = msgspec.to_builtins(setup)
    return setups


def _versions(instance: Instance, settings: Settings) -> Finding:
    try:
        surveys = survey(instance, settings)
        require_same(surveys, settings.here)
    except ValorError as error:
        advice = "install the same valor on all hosts, and the same robot"
        return Finding("versions", "fail", "; ".join(str(error).splitlines()), advice)
    return Finding("versions", "ok", f"the same code and robot on {', '.join(surveys)}")


def _clocks(instance: Instance) -> list[Finding]:
    """Clocks since boot of the other hosts, as this host's bifrostd measures them: messages are stamped by them."""
    if not instance.network_file.exists():
        return []
    info = bifrost.daemon_alive(bifrost.Network.load(instance.network_file, instance.keys), timeout=CLOCK_TIMEOUT)
    if info is None or not info.clocks:
        return [Finding("clocks", "warn", "not measured yet: no other host's bifrostd has responded")]
    clocks = info.clocks.items()
    shown = [f"{name} is {ahead:+.4f} s ahead, to {1e3 * error:.1f} ms" for name, (ahead, error) in clocks]
    return [Finding("clocks", "ok", f"since boot, for Bifrost's stamps: {'; '.join(shown)}")]


def _wall_clocks(answers: Mapping[str, Reply | HostError], here: str) -> Finding:
    """Wall clocks of the other hosts: ROS 2 on hardware stamps by them, and logs."""
    shown, apart = [], 0.0
    for name, answer in answers.items():
        if name != here and isinstance(answer, Reply):
            apart = max(apart, abs(answer.ahead))
            shown.append(f"{name} is {answer.ahead:+.2f} s ahead")
    text = "; ".join(shown) or "no other host responds"
    if apart > CLOCK_DIFFERENCE:
        return Finding("wall clock", "warn", text, "chrony or PTP on every host: ROS 2 on hardware and logs use it")
    return Finding("wall clock", "ok", text)
