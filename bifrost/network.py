"""The network: computers, addresses of their daemons, and the keys that admit a node.

The network file is JSON. The keys folder has one CURVE key pair for sockets that listen (``server.key``), and one for
those that connect (``client.key``); owners of topics (``bifrost.grants``) use their own. Processes that can read the
folder are members; others get no data.
"""

from __future__ import annotations

import json
import os
import random
import socket
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import msgspec
import zmq

from bifrost.errors import ConfigurationError
from bifrost.grants import DAEMON, NONE, AccessPolicy, Grants

_VERSION = 1
_KEY_LENGTH = 40  # Z85 text of a CURVE key
# Below Linux' ephemeral ports, so that no outgoing connection takes the daemon's port while it is down.
_DAEMON_PORTS = range(20000, 32768)


@dataclass(frozen=True)
class Computer:
    """One computer of the network, with the address of its daemon."""

    name: Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,62}$")]
    host: Annotated[str, msgspec.Meta(min_length=1)]
    port: Annotated[int, msgspec.Meta(ge=1, le=65535)]

    @property
    def daemon(self) -> str:
        """The daemon's ZeroMQ endpoint."""
        return f"tcp://{self.host}:{self.port}"


class _Content(msgspec.Struct):
    """Computers in the network file; ``here`` is the computer of this copy."""

    computers: Annotated[tuple[Computer, ...], msgspec.Meta(min_length=1)]
    here: str | None = None


@dataclass(frozen=True)
class KeyPair:
    """A CURVE key pair as Z85 text."""

    public: bytes
    secret: bytes = field(repr=False)

    @classmethod
    def new(cls) -> KeyPair:
        """Generate a key pair."""
        return cls(*zmq.curve_keypair())


@dataclass(frozen=True)
class Network:
    """Settings with which a node joins."""

    computers: tuple[Computer, ...]
    computer: Computer  # that this process runs on
    server: KeyPair  # of listening sockets, owners excepted
    client: KeyPair  # of connecting sockets, owners excepted
    grants: Grants = NONE
    own: KeyPair | None = None  # of this process, if it is an owner
    table_cache: Path | None = None  # file of the daemon's table on disk

    @property
    def listening(self) -> KeyPair:
        """Keys of this process' listening sockets."""
        return self.own or self.server

    @property
    def connecting(self) -> KeyPair:
        """Keys of this process' connecting sockets."""
        return self.own or self.client

    @property
    def own_key(self) -> str:
        """Public key of this process; empty: not an owner."""
        return self.own.public.decode() if self.own else ""

    @property
    def daemon_key(self) -> bytes:
        """The public key of every daemon."""
        return self.grants.owners.get(DAEMON, self.server.public.decode()).encode()

    @property
    def owner(self) -> str:
        """Name of this process as an owner, or ``member``."""
        return self.grants.owner_of(self.own_key)

    @property
    def others(self) -> tuple[Computer, ...]:
        """The other computers of the network."""
        return tuple(computer for computer in self.computers if computer != self.computer)

    @classmethod
    def load(
        cls,
        network_file: Path | str,
        keys_folder: Path | str,
        computer: str | None = None,
        own_key: Path | str | None = None,
    ) -> Network:
        """Read a network file and the keys ``server.key`` and ``client.key``.

        Args:
            network_file: JSON, as ``create`` writes it.
            keys_folder: of the two keys.
            computer: name of the computer that this process runs on; default ``BIFROST_COMPUTER``, then the file's
                ``here``, then the only one.
            own_key: key pair of this process as an owner; ignored in a network without owners.

        Raises:
            ConfigurationError: a file is missing, unreadable, readable by others, or invalid.
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
        return cls(computers, ours, server, client, grants, own, _table_cache(Path(network_file), ours))

    @classmethod
    def create(
        cls,
        network_file: Path | str,
        keys_folder: Path | str,
        host: str = "127.0.0.1",
        ports: Sequence[int] = _DAEMON_PORTS,
        policy: AccessPolicy | None = None,
    ) -> Network:
        """Write the network file of one computer, and new keys.

        Args:
            network_file: replaced if it exists.
            keys_folder: made with mode 0700; its keys are replaced, mode 0600.
            host: address that all sockets of this computer listen on.
            ports: candidates for the daemon's port.
            policy: owners and their rights; None: all members may publish and serve all topics.

        Raises:
            ConfigurationError: the files cannot be written, or no port is free.
        """
        computer = Computer("localhost", host, _free_port(host, ports))
        return cls.create_for([computer], network_file, keys_folder, policy)

    @classmethod
    def create_for(
        cls,
        computers: Sequence[Computer],
        network_file: Path | str,
        keys_folder: Path | str,
        policy: AccessPolicy | None = None,
    ) -> Network:
        """Write the network file of several computers, and new keys, for all computers; see ``create``.

        An owner's key belongs where its process runs; the daemon's on all computers.

        Returns:
            The network of the first computer.
        """
        network_file, keys_folder = Path(network_file), Path(keys_folder)
        server, client = KeyPair.new(), KeyPair.new()
        try:
            network_file.parent.mkdir(parents=True, exist_ok=True)
            _write_keys(keys_folder / "server.key", server)
            _write_keys(keys_folder / "client.key", client)
            grants = _issue(policy) if policy else NONE
            content = {"version": _VERSION, "computers": [asdict(computer) for computer in computers]} | grants.plain()
            write_private(network_file, json.dumps(content, indent=2).encode() + b"\n")
        except OSError as error:
            raise ConfigurationError(f"{error.filename or keys_folder}: {error.strerror}") from None
        return cls(
            tuple(computers), computers[0], server, client, grants, table_cache=_table_cache(network_file, computers[0])
        )

    @classmethod
    def from_environment(cls, owner: str = "") -> Network:
        """The network that ``BIFROST_NETWORK`` (the file) and ``BIFROST_KEYS`` (the folder) name.

        Args:
            owner: name of this process, if it has a key in ``BIFROST_OWNERS`` (the policy's folder).

        Raises:
            ConfigurationError: a variable is not set, or as ``load``.
        """
        for variable, what in (("BIFROST_NETWORK", "the network file"), ("BIFROST_KEYS", "the keys folder")):
            if not os.environ.get(variable):
                raise ConfigurationError(f"{variable} is not set: expected the path of {what}")
        folder = os.environ.get("BIFROST_OWNERS")
        own_key = own_key_file(Path(folder), owner) if owner and folder else None
        return cls.load(os.environ["BIFROST_NETWORK"], os.environ["BIFROST_KEYS"], own_key=own_key)


def copy_for(content: bytes, computer: str) -> bytes:
    """The network file for one of its computers, whose name it states as ``here``."""
    return json.dumps(json.loads(content) | {"here": computer}, indent=2).encode() + b"\n"


def own_key_file(folder: Path, owner: str) -> Path:
    """Path of an owner's key pair in a policy's folder."""
    return folder / owner / "own.key"


def _table_cache(network_file: Path, computer: Computer) -> Path:
    return network_file.with_name(f"{network_file.stem}.{computer.name}.nodes")


def _issue(policy: AccessPolicy) -> Grants:
    """Write a key pair for each owner."""
    public = {}
    for owner in policy.owners:
        pair = KeyPair.new()
        _write_keys(own_key_file(policy.folder, owner), pair)
        public[owner] = pair.public.decode()
    tables = ({name: tuple(owners) for name, owners in t.items()} for t in (policy.publishers, policy.servers))
    return Grants(public, *tables)


def _write_keys(file: Path, pair: KeyPair) -> None:
    """Write a key pair, mode 0600, into a folder of mode 0700."""
    file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    file.parent.chmod(0o700)
    write_private(file, pair.public + b"\n" + pair.secret + b"\n")


def _free_port(host: str, ports: Sequence[int]) -> int:
    # Random: concurrent starts would choose the same port before one of the daemons listens.
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
    """Replace a file atomically, with mode 0600. Raises OSError: it cannot be written."""
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
    """The computers, the grants, and the computer of this copy of the file."""
    try:
        content = json.loads(_read(path, "network file"))
    except ValueError as error:
        raise ConfigurationError(f"{path}: expected JSON: {error}") from None
    if not isinstance(content, dict) or content.get("version") != _VERSION:
        raise ConfigurationError(f"{path}: version: expected {_VERSION}")
    try:
        listed = msgspec.convert(content, _Content)
    except msgspec.ValidationError as error:
        raise ConfigurationError(f"{path}: {error}") from None
    if len({computer.name for computer in listed.computers}) != len(listed.computers):
        raise ConfigurationError(f"{path}: computers: expected names that differ")
    return listed.computers, read_grants(content, path), listed.here


def read_grants(content: Mapping[str, Any], where: Path) -> Grants:
    """The grants of a network file. Raises ConfigurationError: they are invalid."""
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


def _read_keys(path: Path) -> KeyPair:
    content = _read(path, "Bifrost key")
    mode = path.stat().st_mode & 0o777
    if mode & 0o077:
        raise ConfigurationError(f"{path}: mode {mode:04o}: expected 0600, readable only by its owner")
    try:
        public, secret = content.split()
        if zmq.curve_public(secret) != public:
            raise ValueError
    except (ValueError, zmq.ZMQError):
        raise ConfigurationError(
            f"{path}: expected a CURVE key pair: a public key and its secret key, of {_KEY_LENGTH} characters each"
        ) from None
    return KeyPair(public, secret)


def _read(path: Path, what: str) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise ConfigurationError(f"{path}: no such {what}") from None
    except OSError as error:
        raise ConfigurationError(f"{path}: {error.strerror}") from None
