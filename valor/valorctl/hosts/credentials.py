"""The keys by which the agents of a deployment know each other, and the ticket that brings them to a host.

The agents form a Bifrost network of their own: CURVE on every connection, a key pair for each host. Each host has the
network's common keys and its own; whoever commands demands the key of the host that it speaks to.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import msgspec

import bifrost
from bifrost.network import Computer, copy_for, own_key_file, write_private
from valor.common.errors import ConfigurationError, expected
from valor.common.instance import Instance
from valor.valorctl.hosts.deployment import Deployment
from valor.valorctl.instance_setup import private_files

_OTHERS = 0o077
_FOLDER = ".hosts"  # of the home; no instance has such a name


class Ticket(msgspec.Struct):
    """What a host needs to join: files of its folder, by their names there."""

    deployment: str
    host: str
    files: dict[str, bytes]


class Credentials:
    """Where this computer keeps the keys of a deployment."""

    def __init__(self, name: str, home: Path) -> None:
        """Of a deployment, by its name, under a home of instances (``VALOR_HOME``)."""
        self.name = name
        self.folder = home / _FOLDER / name
        self.network_file = self.folder / "network.json"  # of the hosts that the one which joined is to speak with
        self._made = self.folder / "made.json"  # of all, where the keys were made
        self._keys, self._owners = self.folder / "keys", self.folder / "owners"

    @classmethod
    def of(cls, instance: Instance, deployment: str) -> Credentials:
        """Those of an instance's home."""
        return cls(deployment, instance.folder.parent)

    def issue(self, deployment: Deployment) -> None:
        """Make the keys of all hosts, if there are none yet.

        Raises:
            ConfigurationError: those that there are belong to other hosts, or cannot be written.
        """
        if self._made.exists():
            self._require_same(self._made, deployment, deployment.hosts)
            return
        charter = bifrost.Charter(self._owners, publishers={}, servers={f"host/{n}": [n] for n in deployment.hosts})
        computers = [Computer(name, row.address, deployment.agent_port) for name, row in deployment.hosts.items()]
        with private_files():
            bifrost.Network.create_for(computers, self._made, self._keys, charter)

    def ticket(self, host: str, among: Collection[str]) -> bytes:
        """What brings a host all that it needs, and nothing of another host's own.

        Args:
            host: who is to join.
            among: the hosts that it is to speak with, itself included.

        Raises:
            ConfigurationError: not all keys are here.
        """
        files = [self._keys / "server.key", self._keys / "client.key", own_key_file(self._owners, host)]
        try:
            content = {str(file.relative_to(self.folder)): file.read_bytes() for file in files}
            content[self.network_file.name] = copy_for(self._made.read_bytes(), host, among)
        except OSError as error:
            text = f"{error.filename}: {error.strerror}; `host join` works where the deployment's keys were made"
            raise ConfigurationError(text) from None
        return msgspec.msgpack.encode(Ticket(self.name, host, content))

    def network(self) -> bifrost.Network:
        """The agents' network, as the host that this computer has joined as.

        Raises:
            ConfigurationError: it has not joined.
        """
        if not self.network_file.exists():
            raise ConfigurationError(
                f"this computer has not joined deployment {self.name!r} (nothing in {self.folder}); "
                "`valorctl host join` shows, where its keys were made, the command that does"
            )
        try:
            everybody = bifrost.Network.load(self.network_file, self._keys)
            own = own_key_file(self._owners, everybody.computer.name)
            return bifrost.Network.load(self.network_file, self._keys, own_key=own)
        except bifrost.ConfigurationError as error:
            raise ConfigurationError(str(error)) from None

    def require_same(self, deployment: Deployment) -> None:
        """See that the keys are for the hosts of a deployment, of which this computer is one.

        Raises:
            ConfigurationError: names the hosts that differ; or it has not joined.
        """
        self._require_same(self.network_file, deployment, deployment.beside(self.network().computer.name))

    def _require_same(self, file: Path, deployment: Deployment, hosts: Collection[str]) -> None:
        content = msgspec.json.decode(file.read_bytes())
        before = {each["name"]: (each["host"], each["port"]) for each in content["computers"]}
        now = {name: (deployment.hosts[name].address, deployment.agent_port) for name in hosts}
        if differing := sorted({name for name in {*before, *now} if before.get(name) != now.get(name)}):
            raise ConfigurationError(
                f"{self.folder}: its keys are for other hosts or addresses: {', '.join(differing)}; "
                "remove that folder and join every host anew"
            )


def admit(file: Path, home: Path) -> Credentials:
    """Unpack a ticket: this computer joins as the host that it is for.

    Raises:
        ConfigurationError: it is none, others may read it, or it cannot be unpacked.
    """
    try:
        if file.stat().st_mode & _OTHERS:
            raise ConfigurationError(f"{file}: others may read it; expected mode 0600, for it has keys")
        ticket = msgspec.msgpack.decode(file.read_bytes(), type=Ticket)
    except OSError as error:
        raise ConfigurationError(f"{file}: {error.strerror}") from None
    except msgspec.DecodeError:
        raise ConfigurationError(f"{file}: no ticket; expected one that `valorctl host join` has written") from None
    credentials = Credentials(ticket.deployment, home)
    known = {"network.json", "keys/server.key", "keys/client.key", f"owners/{ticket.host}/own.key"}
    if ticket.files.keys() != known or "/" in ticket.deployment or ticket.deployment.startswith("."):
        raise ConfigurationError(f"{file}: no ticket; expected one that `valorctl host join` has written")
    try:
        with private_files():
            for name, content in ticket.files.items():
                place = credentials.folder / name
                place.parent.mkdir(parents=True, exist_ok=True)
                write_private(place, content)
    except OSError as error:
        raise ConfigurationError(f"{error.filename}: {error.strerror}") from None
    return credentials


def joined(name: str, home: Path) -> Credentials:
    """Those of a deployment that this computer has joined.

    Raises:
        ConfigurationError: it has not; lists those that it has.
    """
    known = sorted(folder.name for folder in (home / _FOLDER).glob("*") if (folder / "network.json").exists())
    if name not in known:
        raise ConfigurationError(f"deployment {expected(name, known, 'a ticket, or ')}")
    return Credentials(name, home)
