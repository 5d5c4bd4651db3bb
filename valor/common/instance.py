"""An instance: one running robot system with its own folder, Bifrost network, ROS domain and settings.

``VALOR_HOME`` and ``VALOR_INSTANCE`` name the settings, ``<home>/<name>/instance.json``; ``valorctl up`` writes them.
"""

import math
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, Self

import msgspec
from msgspec import Meta, field

from valor.common.errors import ConfigurationError
from valor.common.resources import middleware_profile
from valor.common.table import Positive, Table, TableError, checked, plain

DEFAULT_NAME = "default"
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,31}")
_TOKEN = r"[A-Za-z](?:_?[A-Za-z0-9])*"  # part of a ROS name that is not hidden
_NAMESPACE = re.compile(rf"{_TOKEN}(?:/{_TOKEN})*")
_LONGEST_NAMESPACE = 64  # the middleware limits complete names of topics to 255
_BAG = "bifrost"  # prefix of the Motion System's topics in bags

ClockMode = Literal["lockstep", "realtime"]
Variant = Literal["simulation", "hardware"]
RosCommands = Literal["all", "none"]


def ros_namespace(text: str) -> str:
    """A namespace as in the settings, without a leading slash; empty: none. Raises ConfigurationError."""
    name = text.removeprefix("/")
    if not name:
        return ""
    if not _NAMESPACE.fullmatch(name) or len(name) > _LONGEST_NAMESPACE or name.split("/")[0] == _BAG:
        shown = text if len(text) <= _LONGEST_NAMESPACE else f"{text[:_LONGEST_NAMESPACE]}…"
        raise ConfigurationError(
            f"namespace {shown!r}: expected letters, digits and single _ in words that begin with a letter, "
            f"/ between them, at most {_LONGEST_NAMESPACE}, and not {_BAG!r} first: escher1, lab/escher1"
        )
    return name


def frame_prefix(namespace: str) -> str:
    """Prefix of the robot's frames in tf."""
    return f"{namespace}/" if namespace else ""


DAY = 86400.0  # [s]
# The piece in progress cannot be removed, so it is limited to this fraction of all recordings.
PIECES = 8
LEAST_PIECE = 1 << 20  # [B]


class Bounds(Table):
    """Bounds of an instance's recordings: a month, some five hours of all topics, a tenth of the disk; None: none."""

    age: Positive | None = 30 * DAY  # since the end of a piece [s]
    size: Annotated[int, Meta(ge=8 * LEAST_PIECE, extra={"unit": "B"})] | None = 20_000_000_000  # total [B]
    share: Annotated[float, Meta(gt=0, le=1)] | None = 0.1  # total, as a fraction of the disk

    def limit(self, capacity: int) -> int | None:
        """Maximum total on a disk of that capacity [B]; None: no limit."""
        limits = [self.size, None if self.share is None else round(self.share * capacity)]
        return min((each for each in limits if each is not None), default=None)

    def piece(self, capacity: int) -> tuple[float, float]:
        """Maximum size [B] and duration [s] of one piece."""
        limit = self.limit(capacity)
        return (
            math.inf if limit is None else max(LEAST_PIECE, limit // PIECES),
            math.inf if self.age is None else self.age / PIECES,
        )


UNBOUNDED = Bounds(age=None, size=None, share=None)


class Recording(Table):
    """Contents and pieces of recordings."""

    only: tuple[str, ...] = ()  # shell patterns of the topics to record; empty: all
    without: tuple[str, ...] = ()  # shell patterns of the topics to exclude
    # Size after which the next bag starts [B]: all file systems allow it, and recovery reads it in seconds.
    split_bytes: Annotated[int, Meta(ge=1 << 20)] = 4_000_000_000
    split_seconds: Annotated[float, Meta(ge=1.0)] | None = None  # [s]
    ring_seconds: Annotated[float, Meta(ge=1.0, le=600.0)] | None = None  # keep in memory, write on request [s]
    bounds: Bounds = Bounds()  # of all recordings of the instance


FOXGLOVE_PORT = 8765  # default of its app


class Listening(Table):
    """Address that a process listens on for other programs."""

    host: str = "127.0.0.1"
    port: Annotated[int, Meta(ge=0, le=65535)] = 0  # 0: any free port


class Host(Table, kw_only=True):
    """A computer of an instance with several computers."""

    name: str
    address: str  # that its processes listen on
    processes: tuple[str, ...] = ()  # on it, in addition to bifrostd
    operator: bool = False  # in the operator's network, connected with the robot's by the link only
    ssh: str = ""  # destination as ssh accepts it; empty: the address
    folder: str = ""  # of the instance on that computer; empty: not made yet


class SshSettings(Table, kw_only=True):
    """How ssh reaches the hosts."""

    config: str = ""  # file, of hosts that have it; empty: the user's
    valorctl: str = "valorctl"  # command for the shell there


WhenLost = Literal["go_on", "stop"]


LINK_RATE = 1200.0  # 9,600 bit/s [B/s]
LEAST_LINK_RATE = 600.0  # below it, a goal of 250 bytes misses its deadline [B/s]
LinkRate = Annotated[float, Meta(ge=LEAST_LINK_RATE)]


class Link(Table):
    """The link between the robot's and the operator's ROS networks (docs/link.md)."""

    domain: Annotated[int, Meta(ge=0, le=232)] | None = None  # the operator's ROS domain; None: no link
    when_lost: WhenLost = "go_on"  # reaction of the robot to a timeout of the operator's end
    lost_after: Annotated[float, Meta(gt=0.0)] = 10.0  # [s]
    listen: str = "127.0.0.1"  # address that the robot's end listens on
    port: Annotated[int, Meta(ge=0, lt=65535)] = 0  # UDP port of its slow channel; 0: from the instance's block
    robot: str = "127.0.0.1"  # its address for the operator's end
    # UDP ports of the robot's end as the operator's end sees them; 0: the ports that it listens on.
    slow: Annotated[int, Meta(ge=0, le=65535)] = 0
    fast: Annotated[int, Meta(ge=0, le=65535)] = 0
    rate: LinkRate = LINK_RATE  # of the slow channel, in both directions together [B/s]
    picture: str = "multisense/left/image_rect_color/compressed"  # sensor_msgs/CompressedImage of the robot's view


class Settings(Table, kw_only=True):
    """Settings of an instance, written by ``valorctl up``."""

    profile: str = "sim"
    variant: Variant = "simulation"  # backend of the Comms Manager
    robot: Path  # the robot's folder
    control_rate: float | None = None  # replaces robot.yaml's [Hz]
    # Ports by device; default: the emulators' (devices/ports.py).
    ports: dict[str, str] = field(default_factory=dict)
    clock: ClockMode = "lockstep"
    actuators: str = "hardware"  # profile in robot.yaml of the plant's deviations from the controller's model
    seed: int = 0
    world: str = "flat"
    real_time_factor: float = 1.0  # of lockstep; 0: as fast as possible
    wait_for_vrc: bool = True  # in lockstep robot time waits for the Valor ROS Controller's cycles, with a timeout
    ros_domain_id: int
    port_block: int = 0  # number of this instance's range of ports; 0: the ROS domain
    namespace: str = ""  # of all ROS nodes and of the robot's frames; empty: none
    peers: tuple[str, ...] = ()  # other computers for ROS 2; empty: this computer only
    deployment: str = ""  # name of the deployment; empty: this computer only
    hosts: tuple[Host, ...] = ()  # of the deployment
    here: str = ""  # name of this host
    ssh: SshSettings = SshSettings()
    run: str = ""  # identifies this run on all hosts; empty: this computer alone
    ros_commands: RosCommands = "all"  # accepted commands on ROS 2, which does not authenticate senders
    epoch: int = 0  # start of robot time on hardware, monotonic [ns]
    bag: Path | None = None  # of the recorder; None: a new one in the instance's bags folder
    recording: Recording = Recording()
    asked: tuple[str, ...] = ()  # processes requested by options
    foxglove: Listening = Listening(port=FOXGLOVE_PORT)
    link: Link = Link()

    def __post_init__(self) -> None:
        if self.namespace != ros_namespace(self.namespace):
            raise TableError(("namespace",), f"got {self.namespace!r}; expected {ros_namespace(self.namespace)!r}")

    @property
    def block(self) -> int:
        """Number of this instance's range of ports."""
        return self.port_block or self.ros_domain_id

    @property
    def near(self) -> tuple[str, ...]:
        """Processes in this computer's network, in addition to bifrostd."""
        return tuple(name for each in self.beside(self.here) for name in each.processes)

    def beside(self, host: str) -> tuple[Host, ...]:
        """All hosts in a host's network; with a link, the robot's or the operator's."""
        operator = any(each.operator for each in self.hosts if each.name == host)
        return tuple(each for each in self.hosts if each.operator == operator)

    def processes_here(self, processes: Sequence[str]) -> tuple[str, ...]:
        """The given processes that run on this computer."""
        own = next((host.processes for host in self.hosts if host.name == self.here), None)
        return tuple(name for name in processes if own is None or name in own)

    @property
    def frame_prefix(self) -> str:
        """Prefix of the robot's frames in tf."""
        return frame_prefix(self.namespace)

    @property
    def ros_arguments(self) -> tuple[str, ...]:
        """ROS arguments that put a program's nodes, and its clock, into the namespace."""
        if not self.namespace:
            return ()
        return ("--ros-args", "-r", f"__ns:=/{self.namespace}", "-r", f"/clock:=/{self.namespace}/clock", "--")

    @property
    def paced(self) -> bool:
        """True if robot time is proportional to wall time, rather than as fast as possible."""
        return self.variant == "hardware" or self.clock == "realtime" or self.real_time_factor > 0.0

    @property
    def ros_refusal(self) -> str:
        """Reason for the rejection of all commands on ROS 2; empty: they are accepted."""
        return "commands on ROS 2 are rejected: up with --ros-commands none" if self.ros_commands == "none" else ""

    def json(self) -> str:
        """Content of ``instance.json``."""
        return msgspec.json.format(msgspec.json.encode(plain(self)).decode(), indent=2) + "\n"


class Instance:
    """Files and folders of an instance."""

    def __init__(self, name: str, home: Path) -> None:
        if not _NAME.fullmatch(name):
            raise ConfigurationError(
                f"instance name {name!r}: expected lower-case letters, digits, - and _, at most 32, "
                "beginning with a letter or digit"
            )
        self.name = name
        self.folder = home / name
        self.settings_file = self.folder / "instance.json"  # missing while the instance is down
        self.network_file = self.folder / "network.json"  # computers and daemons of the Bifrost network
        self.keys = self.folder / "keys"  # of Bifrost, shared by all members; mode 0700
        self.link_key = self.keys / "link.key"  # of both ends of the link on several computers; mode 0600
        self.owners = self.folder / "owners"  # one folder for each process with its own Bifrost key
        self.logs = self.folder / "logs"  # one file for each service, kept after `valorctl down`
        self.operator_token = self.folder / "operator.token"  # to operate the page; new at each `up`
        self.ports = self.folder / "ports"  # serial ports of device emulators, one link for each device
        self.middleware_file = self.folder / "fastdds.xml"  # configuration of an instance with peers
        self.behavior_file = self.folder / "behavior.json"  # last behavior, written by the Comms Manager
        self.bags = self.folder / "bags"  # default folder

    @classmethod
    def from_environment(cls, name: str | None = None) -> Self:
        """The instance named, else ``VALOR_INSTANCE``, else ``default``, in ``VALOR_HOME`` (``~/.valor``)."""
        home = Path(os.environ.get("VALOR_HOME") or Path.home() / ".valor")
        return cls(name or os.environ.get("VALOR_INSTANCE") or DEFAULT_NAME, home)

    @property
    def not_up(self) -> str:
        """Message for the user while the instance is down."""
        return (
            f"instance {self.name!r} is not up (no {self.settings_file}); "
            f"`valorctl up{self.option(self.name)}` starts it"
        )

    @staticmethod
    def option(name: str) -> str:
        """Option of a verb that selects an instance; empty for the default one."""
        return "" if name == DEFAULT_NAME else f" --instance {name}"

    def settings(self) -> Settings:
        """The settings of the running instance. Raises ConfigurationError if it is not up, or its file not readable."""
        try:
            return checked(Settings, msgspec.json.decode(self.settings_file.read_text()))
        except FileNotFoundError:
            raise ConfigurationError(self.not_up) from None
        except (OSError, ValueError) as error:
            raise ConfigurationError(f"{self.settings_file}: {' '.join(str(error).split())}") from None

    def environment(self) -> dict[str, str]:
        """Environment variables of the instance's processes."""
        settings = self.settings()
        return {
            "VALOR_HOME": str(self.folder.parent),
            "VALOR_INSTANCE": self.name,
            "BIFROST_NETWORK": str(self.network_file),
            "BIFROST_KEYS": str(self.keys),
            "ROS_DOMAIN_ID": str(settings.ros_domain_id),
            # LOCALHOST would enable shared memory despite the built-in transports below: discovery of a topic then
            # takes 1.6 s, and milliseconds with loopback UDP only.
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(self.middleware_file if settings.peers else middleware_profile()),
            "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
        }
