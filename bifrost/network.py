"""The network: which computers there are, where their daemons listen, and the keys that admit a node.

The network file is JSON; the keys folder holds one CURVE key pair for everything that listens (``server.key``) and
one for everything that connects (``client.key``). Whoever can read the folder is a member; nobody else gets a byte.
Owners of topics (``bifrost.grants``) have a key pair each, with which they listen and connect instead.
"""

from __future__ import annotations

import json
import os
import random
import re
import socket
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import zmq

from bifrost.errors import ConfigurationError
from bifrost.grants import DAEMON, NONE, Charter, Grants

_VERSION = 1
_KEY_LENGTH = 40  # Z85 text of a CURVE key
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,62}")
# Below Linux' ephemeral ports, so that no outgoing connection takes the daemon's port while it is away.
_DAEMON_PORTS = range(20000, 32768)


@dataclass(frozen=True)
class Computer:
    """One computer of the network and where its daemon listens."""

    name: str
    host: str
    port: int

    @property
    def daemon(self) -> str:
        """The daemon's ZeroMQ endpoint."""
        return f"tcp://{self.host}:{self.port}"


@dataclass(frozen=True)
class KeyPair:
    """A CURVE key pair as Z85 text."""

    public: bytes
    secret: bytes = field(repr=False)

    @classmethod
    def new(cls) -> KeyPair:
        """A fresh one."""
        return cls(*zmq.curve_keypair())


@dataclass(frozen=True)
class Network:
    """Everything a node needs to join.

    Attributes:
        computers: all of the network.
        computer: the one that this process runs on.
        server: the keys of whatever listens, owners excepted.
        client: the keys of whatever connects, owners excepted.
        grants: what is whose alone.
        own: the keys of this process, if it is an owner.
        keepsake: the file in which this computer's daemon leaves its table; None: it leaves none.
    """

    computers: tuple[Computer, ...]
    computer: Computer
    server: KeyPair
    client: KeyPair
    grants: Grants = NONE
    own: KeyPair | None = None
    keepsake: Path | None = None

    @property
    def listening(self) -> KeyPair:
        """What this process listens with."""
        return self.own or self.server

    @property
    def connecting(self) -> KeyPair:
        """What this process connects with."""
        return self.own or self.client

    @property
    def own_key(self) -> str:
        """The public key by which this process is known; empty: it has none of its own."""
        return self.own.public.decode() if self.own else ""

    @property
    def daemon_key(self) -> bytes:
        """The public key of every daemon."""
        return self.grants.owners.get(DAEMON, self.server.public.decode()).encode()

    @property
    def owner(self) -> str:
        """The owner that this process is, or ``member``."""
        return self.grants.owner_of(self.own_key)

    @property
    def others(self) -> tuple[Computer, ...]:
        """The computers of the network but this one."""
        return tuple(computer for computer in self.computers if computer != self.computer)

    @classmethod
    def load(
        cls,
        network_file: Path | str,
        keys_folder: Path | str,
        computer: str | None = None,
        own_key: Path | str | None = None,
    ) -> Network:
        """Read a network file and its keys.

        Args:
            network_file: JSON, as ``create`` writes it.
            keys_folder: holds ``server.key`` and ``client.key``.
            computer: the name of the computer that this process runs on; else ``BIFROST_COMPUTER``, else the file's
                ``here``; may be left out when there is only one.
            own_key: the key pair of the owner that this process is; of a network without owners it is not looked at.

        Raises:
            ConfigurationError: a file is missing, unreadable to us, readable to others, or not what is expected.
        """
        computers, grants, here = _read_network(Path(network_file))
        name = computer or os.environ.get("BIFROST_COMPUTER") or here
        if name is None and len(computers) > 1:
            raise ConfigurationError(
                f"{network_file}: lists {len(computers)} computers; set BIFROST_COMPUTER, or `here`, to this one's name"
            )
        ours = computers[0] if name is None else next((c for c in computers if c.name == name), None)
        if ours is None:
            raise ConfigurationError(
                f"{network_file}: no computer {name!r}; expected one of {', '.join(c.name for c in computers)}"
            )
        keys = Path(keys_folder)
        if not keys.is_dir():
            raise ConfigurationError(f"{keys}: no such folder of Bifrost keys")
        own = _read_keys(Path(own_key)) if own_key is not None and grants.owners else None
        if own is not None and own.public.decode() not in grants.owners.values():
            raise ConfigurationError(f"{own_key}: no key of an owner that {network_file} names")
        server, client = _read_keys(keys / "server.key"), _read_keys(keys / "client.key")
        return cls(computers, ours, server, client, grants, own, _keepsake(Path(network_file), ours))

    @classmethod
    def create(
        cls,
        network_file: Path | str,
        keys_folder: Path | str,
        host: str = "127.0.0.1",
        ports: Sequence[int] = _DAEMON_PORTS,
        charter: Charter | None = None,
    ) -> Network:
        """Write the network file of one computer, and fresh keys.

        Args:
            network_file: overwritten when it exists; its folder is made.
            keys_folder: made with mode 0700; keys in it are overwritten, mode 0600.
            host: the address of this computer's interface that everything listens on.
            ports: of which the daemon gets one that is free.
            charter: what is granted to whom; None: everybody may publish and serve everything.

        Raises:
            ConfigurationError: the files cannot be written, or no port is free.
        """
        computer = Computer("localhost", host, _free_port(host, ports))
        return cls.create_for([computer], network_file, keys_folder, charter)

    @classmethod
    def create_for(
        cls,
        computers: Sequence[Computer],
        network_file: Path | str,
        keys_folder: Path | str,
        charter: Charter | None = None,
    ) -> Network:
        """Write the network file of several computers, and fresh keys; both belong on every one of them.

        Args:
            computers: all of the network; the returned one is the first's.
            network_file: as for ``create``.
            keys_folder: as for ``create``.
            charter: as for ``create``. An owner's key belongs where its process runs; the daemon's on all computers.

        Raises:
            ConfigurationError: the files cannot be written.
        """
        network_file, keys_folder = Path(network_file), Path(keys_folder)
        server, client = KeyPair.new(), KeyPair.new()
        try:
            network_file.parent.mkdir(parents=True, exist_ok=True)
            _write_keys(keys_folder / "server.key", server)
            _write_keys(keys_folder / "client.key", client)
            grants = _issue(charter) if charter else NONE
            content = {"version": _VERSION, "computers": [asdict(computer) for computer in computers]} | grants.plain()
            write_private(network_file, json.dumps(content, indent=2).encode() + b"\n")
        except OSError as error:
            raise ConfigurationError(f"{error.filename or keys_folder}: {error.strerror}") from None
        return cls(
            tuple(computers), computers[0], server, client, grants, keepsake=_keepsake(network_file, computers[0])
        )

    @classmethod
    def from_environment(cls, owner: str = "") -> Network:
        """The network that ``BIFROST_NETWORK`` (the file) and ``BIFROST_KEYS`` (the folder) name.

        Args:
            owner: that this process is, if the network has owners; its key is found under ``BIFROST_OWNERS`` (the
                charter's folder).

        Raises:
            ConfigurationError: a variable is not set, or as ``load``.
        """
        values = []
        for variable, what in (("BIFROST_NETWORK", "the network file"), ("BIFROST_KEYS", "the keys folder")):
            value = os.environ.get(variable)
            if not value:
                raise ConfigurationError(f"{variable} is not set: expected the path of {what}")
            values.append(value)
        network_file, keys_folder = values
        folder = os.environ.get("BIFROST_OWNERS")
        own_key = own_key_file(Path(folder), owner) if owner and folder else None
        return cls.load(network_file, keys_folder, own_key=own_key)


def copy_for(content: bytes, computer: str, among: Collection[str] | None = None) -> bytes:
    """A network file as it belongs on one of its computers, whose processes need not be told where they are.

    ``among``: the computers of which it knows; None: all.
    """
    told = json.loads(content) | {"here": computer}
    told["computers"] = [each for each in told["computers"] if among is None or each["name"] in among]
    return json.dumps(told, indent=2).encode() + b"\n"


def own_key_file(folder: Path, owner: str) -> Path:
    """Where a charter's folder has an owner's key pair."""
    return folder / owner / "own.key"


def _keepsake(network_file: Path, computer: Computer) -> Path:
    return network_file.with_name(f"{network_file.stem}.{computer.name}.nodes")


def _issue(charter: Charter) -> Grants:
    """Make a key pair for every owner."""
    public = {}
    for owner in charter.owners:
        pair = KeyPair.new()
        _write_keys(own_key_file(charter.folder, owner), pair)
        public[owner] = pair.public.decode()
    tables = ({name: tuple(owners) for name, owners in t.items()} for t in (charter.publishers, charter.servers))
    return Grants(public, *tables)


def _write_keys(file: Path, pair: KeyPair) -> None:
    """Write a key pair, mode 0600, into a folder of mode 0700."""
    file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    file.parent.chmod(0o700)
    write_private(file, pair.public + b"\n" + pair.secret + b"\n")


def _free_port(host: str, ports: Sequence[int]) -> int:
    # Not the first: who takes one before that daemon listens would take the same.
    for port in random.SystemRandom().sample(ports, min(len(ports), 200)):
        with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
            try:
                probe.bind((host.strip("[]"), port))
            except OSError as error:
                last = error
                continue
            return port
    raise ConfigurationError(f"no free port for the daemon on {host}: {last.strerror}")


def write_private(path: Path, content: bytes) -> None:
    """Write through a new file of mode 0600, so that no reader ever sees half of it or a looser mode.

    Raises:
        OSError: it cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise


def _read_network(path: Path) -> tuple[tuple[Computer, ...], Grants, str | None]:
    """The computers, the grants, and the name of the computer that this copy of the file is for."""
    try:
        content = json.loads(path.read_text())
    except FileNotFoundError:
        raise ConfigurationError(f"{path}: no such network file") from None
    except OSError as error:
        raise ConfigurationError(f"{path}: {error.strerror}") from None
    except ValueError as error:
        raise ConfigurationError(f"{path}: expected JSON: {error}") from None
    if not isinstance(content, dict) or content.get("version") != _VERSION:
        raise ConfigurationError(f"{path}: version: expected {_VERSION}")
    entries = content.get("computers")
    if not isinstance(entries, list) or not entries:
        raise ConfigurationError(f"{path}: computers: expected a list of at least one computer")
    computers = tuple(_read_computer(path, index, entry) for index, entry in enumerate(entries))
    if len({computer.name for computer in computers}) != len(computers):
        raise ConfigurationError(f"{path}: computers: expected names that differ")
    here = content.get("here")
    if here is not None and not isinstance(here, str):
        raise ConfigurationError(f"{path}: here: expected the name of a computer, got {here!r}")
    return computers, read_grants(content, path), here


def read_grants(content: Mapping[str, Any], where: Path) -> Grants:
    """The grants of a network file.

    Raises:
        ConfigurationError: they are not what is expected.
    """
    names = dict[str, tuple[str, ...]]
    try:
        grants = Grants(
            msgspec.convert(content.get("owners", {}), dict[str, str]),
            msgspec.convert(content.get("publishers", {}), names),
            msgspec.convert(content.get("servers", {}), names),
        )
    except msgspec.ValidationError as error:
        raise ConfigurationError(f"{where}: owners, publishers, servers: {error}") from None
    for name, key in grants.owners.items():
        if len(key) != _KEY_LENGTH:
            raise ConfigurationError(f"{where}: owners.{name}: expected a public key of {_KEY_LENGTH} characters")
    for table, topics in (("publishers", grants.publishers), ("servers", grants.servers)):
        for topic, owners in topics.items():
            if not owners or not grants.owners.keys() >= set(owners):
                raise ConfigurationError(f"{where}: {table}.{topic}: expected names of owners, got {list(owners)}")
    return grants


def _read_computer(path: Path, index: int, entry: object) -> Computer:
    where = f"{path}: computers[{index}]"
    if not isinstance(entry, dict):
        raise ConfigurationError(f"{where}: expected an object with name, host and port")
    name, host, port = entry.get("name"), entry.get("host"), entry.get("port")
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise ConfigurationError(f"{where}.name: expected letters, digits, _, . and -, got {name!r}")
    if not isinstance(host, str) or not host:
        raise ConfigurationError(f"{where}.host: expected an address, got {host!r}")
    if not isinstance(port, int) or isinstance(port, bool) or not 0 < port < 2**16:
        raise ConfigurationError(f"{where}.port: expected 1 to 65535, got {port!r}")
    return Computer(name, host, port)


def _read_keys(path: Path) -> KeyPair:
    try:
        mode = path.stat().st_mode & 0o777
        content = path.read_bytes()
    except FileNotFoundError:
        raise ConfigurationError(f"{path}: no such Bifrost key") from None
    except OSError as error:
        raise ConfigurationError(f"{path}: {error.strerror}") from None
    if mode & 0o077:
        raise ConfigurationError(f"{path}: mode {mode:04o}: expected 0600, readable by its owner alone")
    lines = content.split()
    if [len(line) for line in lines] != [_KEY_LENGTH, _KEY_LENGTH]:
        raise ConfigurationError(f"{path}: expected a public and a secret key of {_KEY_LENGTH} characters each")
    try:
        if zmq.curve_public(lines[1]) != lines[0]:
            raise ValueError
    except (ValueError, zmq.ZMQError):
        raise ConfigurationError(f"{path}: expected a CURVE key pair; these keys do not belong together") from None
    return KeyPair(lines[0], lines[1])
