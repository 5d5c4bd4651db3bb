"""The agent of a host: does there what `valorctl` would do on it, for those who have the deployment's keys.

It holds nothing itself: what it starts is supervisord's, and goes on while it is away.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from functools import partial
from typing import Any

import msgspec

import bifrost
from bifrost.network import copy_for, own_key_file, write_private
from valor.common.errors import ConfigurationError, ValorError
from valor.common.instance import Instance, Settings
from valor.common.linking import NAMES
from valor.common.processes import DAEMON, RECORDER
from valor.common.resources import robot_folder
from valor.common.table import checked, plain
from valor.link.session import shared_secret
from valor.valorctl import instance_setup, leftovers, ros_domain, shutdown, startup
from valor.valorctl.hosts import resuming
from valor.valorctl.hosts.channel import Desk, HostError, Switchboard
from valor.valorctl.hosts.versions import versions
from valor.valorctl.supervision import ProcessState, Supervisor

_log = logging.getLogger("agent")
DAEMON_TIMEOUT = 20.0  # until bifrostd answers [s]
LOOK = 1.0  # between two looks at the other hosts [s]


class Order(msgspec.Struct):
    """What a host is told to make of an instance.

    Attributes:
        settings: of the instance, as plain values; the robot as it is called on every host.
        domain: of ROS, free on all hosts.
        network: the network file.
        keys: common and own ones, by the names of their files in the instance's folder.
    """

    settings: dict[str, Any]
    domain: int
    network: bytes
    keys: dict[str, bytes]


class _ClosingError(Exception):
    """Nobody is asked any more."""


class Agent:
    """The verbs of one host. Each may be called from a thread of its own."""

    def __init__(self, network: bifrost.Network, deployment: str, instance: Callable[[str], Instance]) -> None:
        """As a host of a deployment, in its agents' network; ``instance``: by name, those of this computer."""
        self._deployment = deployment
        self._here = network.computer
        self._network = network
        self._instance = instance
        self._closing = threading.Event()
        self._words: dict[str, dict[str, Any]] = {}
        self._hindrance = ""  # to what was to be started again, as it was logged

    def run(self, stopping: Callable[[], bool], told: Callable[[str], None]) -> None:
        """Answer until told to stop.

        Raises:
            HostError: it cannot listen at its address.
        """
        desk = Desk(self._network, self.verbs)
        told(f"agent of {self._here.name} listens at {self._here.daemon}")
        watcher = threading.Thread(target=self._watch, name="watcher")
        watcher.start()
        try:
            while not stopping():
                desk.run_once()
        finally:
            self._closing.set()
            watcher.join()
            desk.close()

    @property
    def verbs(self) -> Mapping[str, Callable[..., Any]]:
        """By name, what may be asked of it."""
        verbs = (
            self.hello, self.word, self.run_of, self.others, self.versions, self.free_domains, self.make,
            self.processes, self.start, self.stop, self.restarts, self.last_end, self.log_tail, self.down,
            self.findings, self.log_lines,
        )  # fmt: skip
        return {verb.__name__: verb for verb in verbs}

    # --- what changes nothing -------------------------------------------------------------------------------------

    def hello(self) -> float:
        """It is there; its wall clock [s]."""
        return time.time()

    def word(self) -> str:
        """In a few words how the instances here fare, to be remembered by the others."""
        found = []
        home = self._instance("default").folder.parent
        for file in sorted(home.glob("*/instance.json")):
            instance = self._instance(file.parent.name)
            try:
                infos = Supervisor(instance).processes().values()
            except ValorError:
                found.append(f"{instance.name}: without a supervisor")
                continue
            ended = [info.name for info in infos if info.state != ProcessState.RUNNING]
            running = [info.name for info in infos if info.state == ProcessState.RUNNING]
            words = [f"{', '.join(names)} {how}" for names, how in ((running, "running"), (ended, "not")) if names]
            found.append(f"{instance.name}: {'; '.join(words)}")
        return "; ".join(found) or "nothing up"

    def run_of(self, instance: str) -> str:
        """What tells this run of an instance from another; empty: it is not up here."""
        return resuming.run_of(self._instance(instance))

    def others(self) -> dict[str, dict[str, Any]]:
        """By name of the other hosts: ``word``, the last, and ``heard``, when that was (monotonic) [s]."""
        return self._words

    def versions(self, robot: str) -> dict[str, Any]:
        """Of code and robot here."""
        found: dict[str, Any] = msgspec.to_builtins(versions(robot))
        return found

    def free_domains(self, instance: str) -> list[int]:
        """ROS domains that nobody uses here."""
        others = ros_domain.taken(self._instance(instance).folder.parent, but=self._instance(instance))
        return [
            domain
            for domain in ros_domain.DOMAINS
            if domain not in others and not ros_domain.is_reserved(domain) and ros_domain.is_free(domain)
        ]

    def processes(self, instance: str) -> list[dict[str, Any]]:
        """What supervisord knows of the processes here."""
        return [asdict(info) for info in Supervisor(self._instance(instance)).processes().values()]

    def restarts(self, instance: str) -> dict[str, int]:
        """How often each was restarted by itself."""
        return Supervisor(self._instance(instance)).restarts()

    def last_end(self, instance: str, name: str) -> str:
        """How a process ended last."""
        supervisor = Supervisor(self._instance(instance))
        return supervisor.last_end(supervisor.processes()[name])

    def log_tail(self, instance: str, name: str) -> str:
        """The last lines of a process' log."""
        return Supervisor(self._instance(instance)).log_tail(name)

    def findings(self, instance: str) -> list[dict[str, str]]:
        """What `doctor` finds here."""
        from valor.valorctl.checks import run_all

        return [asdict(finding) for finding in run_all(self._instance(instance))]

    def log_lines(self, instance: str, **wanted: Any) -> list[tuple[float, str, str, str, bool]]:
        """What the processes here have printed."""
        from valor.valorctl.hosts.logs import lines_here

        return lines_here(self._instance(instance), **wanted)

    # --- what changes something -----------------------------------------------------------------------------------

    def make(self, instance: str, order: dict[str, Any]) -> str:
        """Make the instance's part here, and start its bifrostd; returns the robot's folder.

        Raises:
            ValorError: it is up here already, or cannot be made.
        """
        told = msgspec.convert(order, Order)
        here = self._instance(instance)
        startup.require_descriptors()
        with instance_setup.private_files(), instance_setup.changing(here):
            startup.refuse_if_up(here)
            if leftovers.processes_of(here) or leftovers.files_of(here):
                shutdown.take_down(here)
            try:
                self._make(here, told)
            except BaseException:
                shutdown.take_down(here)
                raise
        return str(here.settings().robot)

    def start(self, instance: str, name: str) -> None:
        """Start a process."""
        Supervisor(self._instance(instance)).start(name)

    def stop(self, instance: str, names: list[str], timeout: float) -> None:
        """Stop processes."""
        Supervisor(self._instance(instance)).stop(names, timeout)

    def down(self, instance: str) -> bool:
        """Stop everything here, and remove what is there only while it is up."""
        here = self._instance(instance)
        with instance_setup.changing(here):
            return shutdown.take_down(here)

    # --------------------------------------------------------------------------------------------------------------

    def _make(self, instance: Instance, told: Order) -> None:
        wanted = checked(Settings, told.settings)
        row = next(host for host in wanted.hosts if host.name == self._here.name)
        wanted = msgspec.structs.replace(
            wanted,
            robot=robot_folder(str(wanted.robot)),
            here=row.name,
            peers=tuple(host.address for host in wanted.beside(row.name) if host.name != row.name),
            bag=wanted.bag if RECORDER in row.processes else None,
        )
        with ros_domain.reserve_for(instance, told.domain) as reservation:
            if reservation.domain != told.domain:
                raise ValorError(f"ROS domain {told.domain} is in use on {row.name}")
            instance_setup.make(instance, wanted, told.domain, told.domain, partial(self._bring, wanted, told))
            supervisor = resuming.launch(instance, instance.settings(), reservation.fileno())
        _await_daemon(instance, supervisor)

    def _bring(self, settings: Settings, told: Order, instance: Instance) -> None:
        """Put network and keys into the instance's folder."""
        _bring(instance, told)
        homes = {process: host.name for host in settings.hosts for process in host.processes}
        for name, other in (NAMES, NAMES[::-1]):
            if homes.get(name) == self._here.name and self._network.own is not None:
                public = self._network.grants.owners[homes[other]]
                shared = shared_secret(self._network.own.secret, public.encode())
                secret = hashlib.blake2b(instance.name.encode(), key=shared, digest_size=32).digest()
                write_private(instance.link_key, secret)

    def _watch(self) -> None:
        """Remember the last word of every other host."""
        with Switchboard(self._network, again=0.0) as switchboard, contextlib.suppress(_ClosingError):
            others = [name for name in switchboard.names if name != self._here.name]
            home = self._instance("default").folder.parent
            interrupted = list(resuming.interrupted(home, self._deployment))  # when this computer went down
            while not self._closing.wait(LOOK):
                asked = {name: dict[str, Any]() for name in others}
                for name, word in switchboard.ask("word", asked, check=self._check).items():
                    if not isinstance(word, HostError):
                        self._words[name] = {"word": word, "heard": time.monotonic()}
                interrupted = [each for each in interrupted if not self._resumed(each, switchboard, others)]

    def _resumed(self, instance: Instance, switchboard: Switchboard, others: list[str]) -> bool:
        """Take up what goes on elsewhere; False: nobody has said yet whether it does, or it does not start yet."""
        asked = {name: {"instance": instance.name} for name in others}
        answers = switchboard.ask("run_of", asked, check=self._check)
        if not instance.settings_file.exists() or leftovers.processes_of(instance):
            return True  # somebody has taken it down, or up
        if resuming.goes_on(instance, answers):
            try:
                resuming.resume(instance)
                _log.info("instance %s goes on elsewhere: its part here is started again", instance.name)
            except ValorError as error:
                if str(error) != self._hindrance:
                    _log.error("instance %s goes on elsewhere, its part here does not start: %s", instance.name, error)
                self._hindrance = str(error)
                return False
            return True
        return not any(isinstance(answer, HostError) for answer in answers.values())

    def _check(self) -> None:
        if self._closing.is_set():
            raise _ClosingError


def order(instance: Instance, settings: Settings, domain: int, host: str) -> Order:
    """What a host is told, by the files that were made for all of its network.

    Args:
        instance: whose folder has network and keys of all these hosts.
        settings: of the instance.
        domain: of ROS.
        host: who is told.
    """
    row = next(each for each in settings.hosts if each.name == host)
    files = [instance.keys / name for name in ("server.key", "client.key")]
    files += [own_key_file(instance.owners, owner) for owner in (DAEMON, "valorctl", *row.processes)]
    keys = {str(file.relative_to(instance.folder)): file.read_bytes() for file in files if file.exists()}
    network = copy_for(instance.network_file.read_bytes(), host)
    return Order(plain(settings), domain, network, keys)


def _bring(instance: Instance, told: Order) -> None:
    """Put network and keys into the instance's folder."""
    for name, content in told.keys.items():
        file = (instance.folder / name).resolve()
        if not file.is_relative_to(instance.folder.resolve()) or file.suffix != ".key":
            raise ConfigurationError(f"{name}: expected the name of a key in the instance's folder")
        file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        write_private(file, content)
    write_private(instance.network_file, told.network)


def _await_daemon(instance: Instance, supervisor: Supervisor) -> None:
    network = bifrost.Network.load(instance.network_file, instance.keys)
    deadline = time.monotonic() + DAEMON_TIMEOUT
    while bifrost.daemon_alive(network, timeout=0.5) is None:
        info = supervisor.processes()[DAEMON]
        if info.state in (ProcessState.EXITED, ProcessState.FATAL, ProcessState.BACKOFF):
            raise startup.StartError(f"{DAEMON} did not start: {info.problem}{supervisor.log_tail(DAEMON)}")
        if time.monotonic() > deadline:
            raise startup.StartError(f"{DAEMON} does not answer within {DAEMON_TIMEOUT:g} s")
