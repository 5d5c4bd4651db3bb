"""The table of control modes, read from ``control_modes.yaml``."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from valor_common.errors import ConfigurationError

T = TypeVar("T", bound=BaseModel)
FILE = Path(__file__).with_name("control_modes.yaml")


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ControlMode(_Table):
    """One mode; the meaning of each key stands in the file."""

    bdi: int
    upper_body: Literal[-1, 0, 1]
    switch: Literal["immediate", "on_feedback", "hard_reset"]
    motion: tuple[str, str] | None
    joint_controllers: tuple[str, ...]
    robot_controllers: tuple[str, ...] = ()
    to: frozenset[str]
    preempts: bool = False
    when_done: str | None = None


class ControlModeTable(_Table):
    """The whole file."""

    sets: dict[str, tuple[str, ...]]  # named only to be referred to within the file
    modes: dict[str, ControlMode]
    behaviors: dict[str, str]
    emergency_stop: tuple[str, ...]

    @model_validator(mode="after")
    def _names(self) -> ControlModeTable:
        known = set(self.modes)
        for name, mode in self.modes.items():
            if unknown := (set(mode.to) | {mode.when_done or name}) - known:
                raise ValueError(f"modes.{name}: unknown modes {sorted(unknown)}")
            if unknown := set(mode.motion or ()) - set(self.behaviors):
                raise ValueError(f"modes.{name}: motion: unknown behaviors {sorted(unknown)}")
        if unknown := (set(self.behaviors.values()) | set(self.emergency_stop)) - known:
            raise ValueError(f"behaviors or emergency_stop: unknown modes {sorted(unknown)}")
        return self

    @classmethod
    def load(cls, file: Path = FILE) -> ControlModeTable:
        """Read the table.

        Raises:
            ConfigurationError: the file or a key is missing or wrong.
        """
        return load_table(cls, file)

    def fits(self, mode: str, behavior: str) -> bool:
        """Whether the Motion System in ``behavior`` is what ``mode`` stands for."""
        motion = self.modes[mode].motion
        return (motion is not None and motion[1] == behavior) or self.behaviors.get(behavior) == mode

    def running(self, controller: str) -> list[str]:
        """The modes in which a joint controller is active."""
        return [name for name, mode in self.modes.items() if controller in mode.joint_controllers]


def load_table(table: type[T], file: Path) -> T:
    """Read a YAML file into a table.

    Raises:
        ConfigurationError: the file or a key is missing or wrong.
    """
    try:
        return table.model_validate(yaml.safe_load(file.read_text()))
    except OSError as error:
        raise ConfigurationError(f"{file}: {error.strerror}") from None
    except yaml.YAMLError as error:
        raise ConfigurationError(f"{file}: not YAML: {' '.join(str(error).split())}") from None
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "(whole file)"
        raise ConfigurationError(f"{file}: {key}: {first['msg']}") from None
