"""Profiles (``deploy/*.yaml``): which processes run, which mode the robot is brought to, and defaults of ``up``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from msgspec import Meta, field, structs

from valor.common import mode_names
from valor.common.bounds import Bounds
from valor.common.errors import ConfigurationError, expected
from valor.common.instance import ClockMode, Variant
from valor.common.processes import BY_NAME, Process
from valor.common.table import NonNegative, Table, TableError, read
from valor.robot.description import RobotDescription
from valor.robot.tables import ControlRate
from valor.valorctl import recording_options

MODES = "valor_ros_controller"  # the process that knows control modes


class Defaults(Table):
    """What ``valorctl up`` takes where no option says otherwise."""

    robot: str = "escher"  # a name of robots/, or a folder
    clock: ClockMode = "lockstep"
    actuators: str = "hardware"  # a profile of the robot's robot.yaml
    world: str = "flat"
    seed: Annotated[int, Meta(ge=0)] = 0
    real_time_factor: NonNegative = 1.0
    wait_for_vrc: bool = True  # in lockstep: the world waits for the VRC
    bag_bound: tuple[str, ...] = ()  # of all recordings: 20GB, 30d, 10% (docs/bag_recorder.md)


class Profile(Table, kw_only=True):
    """One file of ``deploy``."""

    description: str
    variant: Variant = "simulation"  # what the Comms Manager runs on
    control_rate: ControlRate | None = None  # instead of the robot's own [Hz]
    # Of devices, where they are not the emulators' (valor/devices/ports.py).
    ports: dict[str, str] = field(default_factory=dict)
    processes: Annotated[tuple[str, ...], Meta(min_length=1)] = ()  # none named: all that the variant has, unasked
    initial_mode: str | None = None
    peers: tuple[str, ...] = ()  # other computers that ROS 2 reaches; none: it stays on this one
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
        """Raise ``TableError`` unless it is a mode that the robot can be brought to, by a process that does so."""
        if self.initial_mode is None:
            return
        if MODES not in self.processes:
            raise TableError(("initial_mode",), f"got {self.initial_mode!r}; expected {MODES} in processes, or no mode")
        if self.initial_mode not in (modes := mode_names.initial()):
            raise TableError(("initial_mode",), expected(self.initial_mode, modes))

    @classmethod
    def load(cls, file: Path) -> Profile:
        """Read a profile.

        Raises:
            ConfigurationError: names the file, the key and what was expected.
        """
        return read(cls, file)

    def suiting(self, robot: RobotDescription) -> Profile:
        """The profile without the processes that serve devices which the robot does not have."""
        kinds = {"", *(device.kind for device in robot.tables.devices.values())}
        return structs.replace(self, processes=tuple(n for n in self.processes if BY_NAME[n].device in kinds))

    def without(self, name: str) -> Profile:
        """The profile without a process that no other needs."""
        return structs.replace(self, processes=tuple(each for each in self.processes if each != name))

    def adding(self, name: str) -> Profile:
        """The profile with a process that an option asks for."""
        return structs.replace(self, processes=tuple(dict.fromkeys((*self.processes, name))))

    @property
    def table(self) -> tuple[Process, ...]:
        """Its rows of the process table, in the table's order."""
        return tuple(process for name, process in BY_NAME.items() if name in self.processes)
