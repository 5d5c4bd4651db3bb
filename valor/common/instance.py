"""An instance: one running robot system with its own folder, Bifrost network, ROS domain and settings.

``valorctl up`` writes the settings to ``<home>/<name>/instance.json``; every service reads them from there, named by
``VALOR_HOME`` and ``VALOR_INSTANCE`` in its environment. Two instances share nothing.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, field

from valor.common.bounds import Bounds
from valor.common.errors import ConfigurationError
from valor.common.resources import middleware_profile
from valor.common.table import Table, checked, plain

DEFAULT_NAME = "default"
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,31}")

ClockMode = Literal["lockstep", "realtime"]
Variant = Literal["simulation", "hardware"]
RosCommands = Literal["all", "none"]


class Recording(Table):
    """What the recorder keeps, and in which pieces."""

    only: tuple[str, ...] = ()  # shell patterns of topics' names in the bag; none: all
    without: tuple[str, ...] = ()  # and of those left out
    # Of a bag, after which the next begins [B]: what every file system takes, and a recovery reads in seconds.
    split_bytes: Annotated[int, Meta(ge=1 << 20)] = 4_000_000_000
    split_seconds: Annotated[float, Meta(ge=1.0)] | None = None  # [s]
    ring_seconds: Annotated[float, Meta(ge=1.0, le=600.0)] | None = None  # hold so much, and write it when asked [s]
    bounds: Bounds = Bounds()  # of all recordings in the instance's folder


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
    ros_domain_id: int
    ros_commands: RosCommands = "all"  # whose commands on ROS 2 are obeyed: there nobody proves who they are
    epoch: int = 0  # when robot time is 0 on hardware, monotonic [ns]
    bag: Path | None = None  # where the recorder writes; None: a new file in the instance's bags folder
    recording: Recording = Recording()

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
    def owners(self) -> Path:
        """Of each process the Bifrost key that is its own, in a folder of its own (``BIFROST_OWNERS``)."""
        return self.folder / "owners"

    @property
    def logs(self) -> Path:
        """One log file a service, kept after ``valorctl down``."""
        return self.folder / "logs"

    @property
    def ports(self) -> Path:
        """Where device emulators put their serial ports: one link a device."""
        return self.folder / "ports"

    @property
    def behavior_file(self) -> Path:
        """What the robot was last told to be in; the Comms Manager's."""
        return self.folder / "behavior.json"

    @property
    def bags(self) -> Path:
        """Where bags go unless told otherwise."""
        return self.folder / "bags"

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
        return {
            "VALOR_HOME": str(self.folder.parent),
            "VALOR_INSTANCE": self.name,
            "BIFROST_NETWORK": str(self.network_file),
            "BIFROST_KEYS": str(self.keys),
            "ROS_DOMAIN_ID": str(self.settings().ros_domain_id),
            # The range LOCALHOST would bring shared memory back whatever the built-in transports are said to be, and
            # with it 1.6 s until a topic is discovered, where loopback UDP alone takes milliseconds.
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(middleware_profile()),
            "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
        }
