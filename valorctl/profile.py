"""Profiles (``deploy/*.yaml``): which processes run, which mode the robot is brought to, and defaults of ``up``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from valor_common.errors import ConfigurationError
from valor_common.instance import ClockMode, Variant
from valor_common.processes import BY_NAME, Process


class Defaults(BaseModel):
    """What ``valorctl up`` takes where no option says otherwise."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    robot: str = "escher"  # a name of robots/, or a folder
    clock: ClockMode = "lockstep"
    actuators: str = "hardware"  # a profile of the robot's robot.yaml
    world: str = "flat"
    seed: int = 0
    real_time_factor: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 1.0


class Profile(BaseModel):
    """One file of ``deploy``."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    description: str
    variant: Variant = "simulation"  # what the Comms Manager runs on
    control_rate: Annotated[float, Field(gt=0, le=1000)] | None = None  # instead of the robot's own [Hz]
    ports: dict[str, str] = {}  # of devices, where they are not the emulators' (valor_common/devices/ports.py)
    processes: Annotated[tuple[str, ...], Field(min_length=1)]
    initial_mode: str | None = None
    defaults: Defaults = Defaults()

    @model_validator(mode="after")
    def _processes_known_and_complete(self) -> Self:
        for name in self.processes:
            if name not in BY_NAME:
                raise ValueError(f"processes: {name!r} is none of {', '.join(BY_NAME)}")
            for need in BY_NAME[name].needs:
                if need not in self.processes:
                    raise ValueError(f"processes: {name} needs {need}")
        return self

    @classmethod
    def load(cls, file: Path) -> Profile:
        """Read a profile.

        Raises:
            ConfigurationError: names the file, the key and what was expected.
        """
        try:
            return cls.model_validate(yaml.safe_load(file.read_text()))
        except OSError as error:
            raise ConfigurationError(f"{file}: {error.strerror}") from None
        except yaml.YAMLError as error:
            raise ConfigurationError(f"{file}: not YAML: {' '.join(str(error).split())}") from None
        except ValidationError as error:
            first = error.errors()[0]
            key = ".".join(str(part) for part in first["loc"])
            raise ConfigurationError(f"{file}: {f'{key}: ' if key else ''}{first['msg']}") from None

    @property
    def table(self) -> tuple[Process, ...]:
        """Its rows of the process table, in the table's order."""
        return tuple(process for name, process in BY_NAME.items() if name in self.processes)
