"""Profiles (``deploy/*.yaml``): processes, initial mode, and defaults of ``up``."""

from pathlib import Path
from typing import Annotated, Self

from msgspec import Meta, field, structs

from valor.common import mode_names
from valor.common.errors import ConfigurationError, expected
from valor.common.instance import Bounds, ClockMode, Variant
from valor.common.processes import BY_NAME, Process
from valor.common.table import NonNegative, Table, TableError, read
from valor.robot.description import RobotDescription
from valor.robot.tables import ControlRate
from valor.valorctl.recordings import recording_options

SLOWEST = 0.01  # real-time factor; below it the processes' timeouts end before robot time advances
MODES = "valor_ros_controller"  # the process that implements control modes


class Defaults(Table):
    """Values of ``valorctl up`` without options."""

    robot: str = "escher"  # a name of robots/, or a folder
    clock: ClockMode = "lockstep"
    actuators: str = "hardware"  # a profile of the robot's robot.yaml
    world: str = "flat"
    seed: Annotated[int, Meta(ge=0)] = 0
    real_time_factor: NonNegative = 1.0
    wait_for_vrc: bool = True  # in lockstep: the world waits for the VRC
    bag_bound: tuple[str, ...] = ()  # of all recordings: 20GB, 30d, 10% (docs/bag_recorder.md)

    def __post_init__(self) -> None:
        if 0.0 < self.real_time_factor < SLOWEST:
            what = f"got {self.real_time_factor}; expected 0, as fast as possible, or at least {SLOWEST}"
            raise TableError(("real_time_factor",), what)


class Profile(Table, kw_only=True):
    """One file of ``deploy``."""

    description: str
    variant: Variant = "simulation"  # backend of the Comms Manager
    control_rate: ControlRate | None = None  # replaces the robot's [Hz]
    # Ports of devices, if not the emulators' (valor/devices/ports.py).
    ports: dict[str, str] = field(default_factory=dict)
    processes: Annotated[tuple[str, ...], Meta(min_length=1)] = ()  # default: all of the variant without an option
    initial_mode: str | None = None
    peers: tuple[str, ...] = ()  # other computers in the ROS 2 network
    defaults: Defaults = Defaults()

    def __post_init__(self) -> None:
        hardware = self.variant == "hardware"
        usual = (row for row in BY_NAME.values() if not row.option)
        everything = tuple(row.name for row in usual if hardware or not row.hardware_only)
        structs.force_setattr(self, "processes", self.processes or everything)
        try:
            recording_options.bounds(self.defaults.bag_bound, Bounds(), "defaults.bag_bound")
        except ConfigurationError as error:
            raise TableError(("defaults", "bag_bound"), str(error)) from None
        for place, name in enumerate(self.processes):
            path = ("processes", str(place))
            if name not in BY_NAME:
                raise TableError(path, expected(name, BY_NAME))
            if name in self.processes[:place]:
                raise TableError(path, f"got {name!r} for the second time; expected each process once")
            if missing := [need for need in BY_NAME[name].needs if need not in self.processes]:
                raise TableError(path, f"{name} needs {missing[0]}; expected it here, too")
            if BY_NAME[name].hardware_only and not hardware:
                raise TableError(path, f"got {name!r}, which no simulation has; expected variant: hardware")
        self._check_initial_mode()

    def _check_initial_mode(self) -> None:
        if self.initial_mode is None:
            return
        if MODES not in self.processes:
            raise TableError(("initial_mode",), f"got {self.initial_mode!r}; expected {MODES} in processes, or no mode")
        if self.initial_mode not in (modes := mode_names.initial()):
            raise TableError(("initial_mode",), expected(self.initial_mode, modes))

    @classmethod
    def load(cls, file: Path) -> Self:
        """Read a profile. Raises ``ConfigurationError``: names file, key, value and expectation."""
        return read(cls, file)

    def suiting(self, robot: RobotDescription) -> Self:
        """The profile without processes for devices that the robot does not have."""
        kinds = {"", *(device.kind for device in robot.tables.devices.values())}
        return structs.replace(self, processes=tuple(n for n in self.processes if BY_NAME[n].device in kinds))

    @property
    def table(self) -> tuple[Process, ...]:
        """Its rows of the process table, in the order of the table."""
        return tuple(process for name, process in BY_NAME.items() if name in self.processes)
