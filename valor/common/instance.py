"""An instance: one running robot system with its own folder, Bifrost network, ROS domain and settings.

``valorctl up`` writes the settings to ``<home>/<name>/instance.json``; every service reads them from there, named by
``VALOR_HOME`` and ``VALOR_INSTANCE`` in its environment. Two instances share nothing.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, field

from valor.common.bounds import Bounds
from valor.common.errors import ConfigurationError
from valor.common.resources import middleware_profile
from valor.common.table import Table, TableError, checked, plain

DEFAULT_NAME = "default"
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,31}")
_TOKEN = r"[A-Za-z](?:_?[A-Za-z0-9])*"  # of a ROS name that is not hidden
_NAMESPACE = re.compile(rf"{_TOKEN}(?:/{_TOKEN})*")
_LONGEST_NAMESPACE = 64  # a topic's whole name is bounded by the middleware: 255
_BAG = "bifrost"  # where bags have the Motion System's messages

ClockMode = Literal["lockstep", "realtime"]
Variant = Literal["simulation", "hardware"]
RosCommands = Literal["all", "none"]


def ros_namespace(text: str) -> str:
    """A namespace as the settings hold it: without the slash that it may begin with; empty: none.

    Raises:
        ConfigurationError: it is none.
    """
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
    """What the names in tf of a robot's frames begin with."""
    return f"{namespace}/" if namespace else ""


class Recording(Table):
    """What the recorder keeps, and in which pieces."""

    only: tuple[str, ...] = ()  # shell patterns of topics' names in the bag; none: all
    without: tuple[str, ...] = ()  # and of those left out
    # Of a bag, after which the next begins [B]: what every file system takes, and a recovery reads in seconds.
    split_bytes: Annotated[int, Meta(ge=1 << 20)] = 4_000_000_000
    split_seconds: Annotated[float, Meta(ge=1.0)] | None = None  # [s]
    ring_seconds: Annotated[float, Meta(ge=1.0, le=600.0)] | None = None  # hold so much, and write it when asked [s]
    bounds: Bounds = Bounds()  # of all recordings in the instance's folder


FOXGLOVE_PORT = 8765  # where its app looks by itself


class Listening(Table):
    """Where a process listens for others' programs."""

    host: str = "127.0.0.1"
    port: Annotated[int, Meta(ge=0, le=65535)] = 0  # 0: any that is free


class Host(Table, kw_only=True):
    """A computer of an instance that runs on several."""

    name: str
    address: str  # that all of it listens on there
    processes: tuple[str, ...] = ()  # that run there, besides bifrostd
    operator: bool = False  # in the operator's network, which the link alone joins with the robot's


WhenLost = Literal["go_on", "stop"]


class Link(Table):
    """The operator's ROS network behind a link of its own (docs/link.md)."""

    domain: Annotated[int, Meta(ge=0, le=232)] | None = None  # the operator's ROS domain; None: there is no link
    when_lost: WhenLost = "go_on"  # what the robot does when the operator's end is not heard
    lost_after: Annotated[float, Meta(gt=0.0)] = 10.0  # [s]
    listen: str = "127.0.0.1"  # where the robot's end listens
    port: Annotated[int, Meta(ge=0, lt=65535)] = 0  # UDP, of its slow channel; 0: as the instance's block has it
    robot: str = "127.0.0.1"  # by which address the operator's end reaches it
    # UDP ports by which the operator's end reaches the robot's; 0: the robot end's own.
    slow: Annotated[int, Meta(ge=0, le=65535)] = 0
    fast: Annotated[int, Meta(ge=0, le=65535)] = 0
    picture: str = "camera/image_raw/compressed"  # sensor_msgs/CompressedImage of the robot's view


class Settings(Table, kw_only=True):
    """What ``valorctl up`` decided for an instance."""

    profile: str = "sim"
    variant: Variant = "simulation"  # what the Comms Manager runs on
    robot: Path  # the robot's folder
    control_rate: float | None = None  # instead of robot.yaml's [Hz]
    # Of devices: where they are plugged in; not named: the emulators' (devices/ports.py).
    ports: dict[str, str] = field(default_factory=dict)
    clock: ClockMode = "lockstep"
    actuators: str = "hardware"  # a profile of robot.yaml: how far the plant is from the controller's model
    seed: int = 0
    world: str = "flat"
    real_time_factor: float = 1.0  # lockstep is paced to this; 0: as fast as it goes
    wait_for_vrc: bool = True  # in lockstep robot time waits for the Valor ROS Controller's cycles, bounded
    ros_domain_id: int
    port_block: int = 0  # a number in ROS domains' range, with it ports, that is this instance's alone; 0: the domain's
    namespace: str = ""  # of all ROS nodes, and of the robot's frames; empty: none
    peers: tuple[str, ...] = ()  # other computers that ROS 2 reaches; none: it stays on this one
    deployment: str = ""  # whose hosts it runs on; empty: this computer alone
    hosts: tuple[Host, ...] = ()  # of the deployment
    here: str = ""  # which of them this is
    ros_commands: RosCommands = "all"  # whose commands on ROS 2 are obeyed: there nobody proves who they are
    epoch: int = 0  # when robot time is 0 on hardware, monotonic [ns]
    bag: Path | None = None  # where the recorder writes; None: a new file in the instance's bags folder
    recording: Recording = Recording()
    asked: tuple[str, ...] = ()  # processes that run because an option asks for them
    foxglove: Listening = Listening(port=FOXGLOVE_PORT)
    link: Link = Link()

    def __post_init__(self) -> None:
        if self.namespace != ros_namespace(self.namespace):
            raise TableError(("namespace",), f"got {self.namespace!r}; expected {ros_namespace(self.namespace)!r}")

    @property
    def block(self) -> int:
        """The number of the ports that are this instance's alone."""
        return self.port_block or self.ros_domain_id

    @property
    def near(self) -> tuple[str, ...]:
        """Processes of the hosts that this computer's network has, besides bifrostd."""
        return tuple(name for each in self.beside(self.here) for name in each.processes)

    def beside(self, host: str) -> tuple[Host, ...]:
        """The hosts of a host's network, itself included: where there is a link, the robot's or the operator's."""
        operator = any(each.operator for each in self.hosts if each.name == host)
        return tuple(each for each in self.hosts if each.operator == operator)

    def processes_here(self, processes: Sequence[str]) -> tuple[str, ...]:
        """Of all processes of the instance, those that run on this computer."""
        own = next((host.processes for host in self.hosts if host.name == self.here), None)
        return tuple(name for name in processes if own is None or name in own)

    @property
    def frame_prefix(self) -> str:
        """What the names of the robot's frames in tf begin with."""
        return frame_prefix(self.namespace)

    @property
    def ros_arguments(self) -> tuple[str, ...]:
        """What puts a program's nodes into the namespace, where robot time is another than of other robots."""
        if not self.namespace:
            return ()
        return ("--ros-args", "-r", f"__ns:=/{self.namespace}", "-r", f"/clock:=/{self.namespace}/clock", "--")

    @property
    def paced(self) -> bool:
        """Whether robot time is kept to the wall's, in some proportion, and not simulated as fast as it goes."""
        return self.variant == "hardware" or self.clock == "realtime" or self.real_time_factor > 0.0

    @property
    def ros_refusal(self) -> str:
        """Why nobody who commands on ROS 2 is obeyed; empty: everybody is."""
        return "commands on ROS 2 are not obeyed: up with --ros-commands none" if self.ros_commands == "none" else ""

    def json(self) -> str:
        """As ``instance.json`` holds them."""
        return msgspec.json.format(msgspec.json.encode(plain(self)).decode(), indent=2) + "\n"


class Instance:
    """Where an instance keeps its things."""

    def __init__(self, name: str, home: Path) -> None:
        if not _NAME.fullmatch(name):
            raise ConfigurationError(
                f"instance name {name!r}: expected lower-case letters, digits, - and _, at most 32, "
                "beginning with a letter or digit"
            )
        self.name = name
        self.folder = home / name

    @classmethod
    def from_environment(cls, name: str | None = None) -> Instance:
        """The instance named, else ``VALOR_INSTANCE``, else ``default``, under ``VALOR_HOME`` (``~/.valor``)."""
        home = Path(os.environ.get("VALOR_HOME") or Path.home() / ".valor")
        return cls(name or os.environ.get("VALOR_INSTANCE") or DEFAULT_NAME, home)

    @property
    def settings_file(self) -> Path:
        """Written by ``valorctl up``; absent while the instance is down."""
        return self.folder / "instance.json"

    @property
    def network_file(self) -> Path:
        """The Bifrost network: computers and their daemons (``BIFROST_NETWORK``)."""
        return self.folder / "network.json"

    @property
    def keys(self) -> Path:
        """The folder of the Bifrost keys that all members share, mode 0700 (``BIFROST_KEYS``)."""
        return self.folder / "keys"

    @property
    def link_key(self) -> Path:
        """Where the ends of its link are on several computers: the secret that both have, mode 0600."""
        return self.keys / "link.key"

    @property
    def owners(self) -> Path:
        """Of each process the Bifrost key that is its own, in a folder of its own (``BIFROST_OWNERS``)."""
        return self.folder / "owners"

    @property
    def logs(self) -> Path:
        """One log file a service, kept after ``valorctl down``."""
        return self.folder / "logs"

    @property
    def operator_token(self) -> Path:
        """The file with the word by which a viewer of the page becomes its operator; another at each ``up``."""
        return self.folder / "operator.token"

    @property
    def viewer_token(self) -> Path:
        """The file with the word by which the page may be seen from another computer; another at each ``up``."""
        return self.folder / "viewer.token"

    @property
    def viewing_file(self) -> Path:
        """Where the page is served: written by whoever starts it."""
        return self.folder / "viewing.json"

    @property
    def ports(self) -> Path:
        """Where device emulators put their serial ports: one link a device."""
        return self.folder / "ports"

    @property
    def middleware_file(self) -> Path:
        """Fast DDS' configuration of an instance that has peers."""
        return self.folder / "fastdds.xml"

    @property
    def behavior_file(self) -> Path:
        """What the robot was last told to be in; the Comms Manager's."""
        return self.folder / "behavior.json"

    @property
    def bags(self) -> Path:
        """Where bags go unless told otherwise."""
        return self.folder / "bags"

    @property
    def fetched(self) -> Path:
        """Where the operator's end of the link puts the bags that it fetched from the robot."""
        return self.folder / "fetched"

    @property
    def not_up(self) -> str:
        """What to say of it while it is down: how to get it up."""
        return (
            f"instance {self.name!r} is not up (no {self.settings_file}); "
            f"`valorctl up{self.option(self.name)}` starts it"
        )

    @staticmethod
    def option(name: str) -> str:
        """What names an instance behind a verb: nothing, if it is the default one."""
        return "" if name == DEFAULT_NAME else f" --instance {name}"

    def settings(self) -> Settings:
        """The settings of the running instance.

        Raises:
            ConfigurationError: the instance is not up, or its file is not readable.
        """
        try:
            return checked(Settings, msgspec.json.decode(self.settings_file.read_text()))
        except FileNotFoundError:
            raise ConfigurationError(self.not_up) from None
        except (OSError, ValueError) as error:
            raise ConfigurationError(f"{self.settings_file}: {' '.join(str(error).split())}") from None

    def environment(self) -> dict[str, str]:
        """The variables with which any process joins the instance."""
        settings = self.settings()
        return {
            "VALOR_HOME": str(self.folder.parent),
            "VALOR_INSTANCE": self.name,
            "BIFROST_NETWORK": str(self.network_file),
            "BIFROST_KEYS": str(self.keys),
            "ROS_DOMAIN_ID": str(settings.ros_domain_id),
            # The range LOCALHOST would bring shared memory back whatever the built-in transports are said to be, and
            # with it 1.6 s until a topic is discovered, where loopback UDP alone takes milliseconds.
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(self.middleware_file if settings.peers else middleware_profile()),
            "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
        }
