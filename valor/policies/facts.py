"""Facts about a policy with their sources, and problems; the sidecar, in which a user states facts."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import Meta

from valor.common.errors import ConfigurationError
from valor.common.table import Positive, Table, checked, plain, read

PerJoint = float | list[float] | dict[str, float]
Range = tuple[float, float]

# Facts in the order of tables, and how a sidecar states them.
FACTS: dict[str, str] = {
    "joints": "joints: [NAME, …]",
    "joint_names": "joint_names: {NAME IN THE FILE: NAME IN THE ROBOT, …}",
    "period": "period: 0.02  # s",
    "observation": "observation: [TERM, {term: TERM, scale: 0.05, clip: [-5, 5], history: 5}, …]",
    "history_order": "history_order: oldest_first  # or newest_first",
    "history_start": "history_start: repeat  # the first sample, or zeros",
    "quaternion_order": "quaternion_order: wxyz  # or xyzw",
    "gait": "gait: {period: 0.8, offsets: [0, 3.14159], standing: 3.14159}  # s, rad",
    "command_ranges": "command_ranges: {vx: [-1, 1], vy: [-0.5, 0.5], wz: [-1, 1]}  # m/s, rad/s",
    "default_position": "default_position: {JOINT: 0.1, …}  # rad",
    "action_scale": "action_scale: 0.25  # rad; or {JOINT: 0.25, …}",
    "action_offset": "action_offset: default_position  # or {JOINT: 0.1, …} in rad",
    "action_clip": "action_clip: [[-100, 100]]  # of all, or of each joint",
    "position_clip": "position_clip: [[-1.5, 1.5]]  # rad, of all, or of each joint",
    "stiffness": "stiffness: {JOINT: 100, …}  # N·m/rad",
    "damping": "damping: {JOINT: 2, …}  # N·m·s/rad",
    "outputs": "outputs: {action: OUTPUT}  # or position, velocity, effort, stiffness, damping",
    "feedback": "feedback: {INPUT: OUTPUT, …}",
    "constants": "constants: {INPUT: [0.0, …], …}",
}


class Source(StrEnum):
    """Origin of a fact."""

    FILE = "file"  # the ONNX file
    TABLE = "table"  # the exporter's YAML file next to it
    DEFAULT = "default"  # fixed by the convention
    USER = "user"  # the sidecar
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class Fact:
    """A value, its source, and the key or rule there."""

    value: Any
    source: Source
    where: str = ""


UNKNOWN = Fact(None, Source.UNKNOWN)


class TermFact(Table):
    """A term of the observation, as a sidecar or a convention states it."""

    term: str  # in ``observations.TERMS``; empty: the convention's is not known here
    name: str = ""  # in the convention
    scale: float | tuple[float, ...] = 1.0
    offset: float | tuple[float, ...] = 0.0  # after the scale
    clip: Range | None = None  # before the scale
    history: Annotated[int, Meta(ge=1, le=1000)] = 1  # samples
    size: int | None = None  # of a sample, if stated
    joints: tuple[str, ...] | None = None  # names in the file; None: all of the policy
    input: str | None = None  # of the model; None: the only one
    value: tuple[float, ...] | None = None  # of the term ``constant``

    def __str__(self) -> str:
        scale, clip = ("×", self.scale, 1.0), ("within", self.clip, None)
        stated = scale, ("+", self.offset, 0.0), clip, ("samples", self.history, 1)
        details = [f"{word} {each}" for word, each, usual in stated if each != usual]
        return " ".join([self.term or f"{self.name} (not known here)", *details])


class Gait(Table):
    """Phases of the feet, which advance by 2π in a period [s]."""

    period: Positive
    offsets: tuple[float, ...] = (0.0, math.pi)  # at the start [rad]
    standing: float | None = None  # phase of all feet while the commanded velocity is zero; None: they go on


class Ranges(Table):
    """Velocity commands that the policy was trained for: forward, left [m/s], turning left [rad/s]."""

    vx: Range | None = None
    vy: Range | None = None
    wz: Range | None = None


class Sidecar(Table):
    """Facts by their names in ``FACTS``; they replace those of the file."""

    joints: list[str] | None = None
    joint_names: dict[str, str] | None = None
    period: Positive | None = None
    observation: list[str | TermFact] | None = None
    history_order: Literal["oldest_first", "newest_first"] | None = None
    history_start: Literal["repeat", "zeros"] | None = None
    quaternion_order: Literal["wxyz", "xyzw"] | None = None
    gait: Gait | None = None
    command_ranges: Ranges | None = None
    default_position: PerJoint | None = None
    action_scale: PerJoint | None = None
    action_offset: PerJoint | Literal["default_position"] | None = None
    action_clip: list[Range] | None = None
    position_clip: list[Range] | None = None
    stiffness: PerJoint | None = None
    damping: PerJoint | None = None
    outputs: dict[Literal["action", "position", "velocity", "effort", "stiffness", "damping"], str] | None = None
    feedback: dict[str, str] | None = None
    constants: dict[str, list[float]] | None = None


@dataclass
class Reading:
    """Facts that one convention and the sidecar state, and problems: fact, what was found, what is expected."""

    convention: str
    facts: dict[str, Fact] = field(default_factory=dict)
    problems: list[tuple[str, str, str]] = field(default_factory=list)
    initial: dict[str, Any] = field(default_factory=dict)  # arrays of inputs that are fed back, before the first act

    def state(self, name: str, value: Any, source: Source, where: str) -> None:
        """Add a fact, unless its value is None."""
        if value is not None:
            self.facts[name] = Fact(value, source, where)

    def reject(self, fact: str, found: object, expected: object) -> None:
        """Add a problem."""
        self.problems.append((fact, str(found)[:160], str(expected)))

    def value(self, name: str) -> Any:
        """Value of a fact; None: unknown."""
        return self.facts.get(name, UNKNOWN).value

    def apply(self, sidecar: Path) -> None:
        """Replace facts by those of a sidecar, if it exists. Raises ConfigurationError: a line for each wrong key."""
        if sidecar.is_file():
            self._replace(read(Sidecar, sidecar), Source.USER, sidecar.name)

    def embed(self, text: str) -> None:
        """Replace facts by those of a sidecar in the file's metadata, as JSON."""
        try:
            self._replace(checked(Sidecar, json.loads(text)), Source.FILE, "metadata valor")
        except ValueError as error:  # also TableError
            self.reject("metadata valor", error, "facts as in a sidecar, as JSON")

    def _replace(self, stated: Sidecar, source: Source, where: str) -> None:
        for name in Sidecar.__struct_fields__:
            value: Any = getattr(stated, name)
            if name == "observation" and value is not None:
                value = tuple(TermFact(term=each, name=each) if isinstance(each, str) else each for each in value)
            self.state(name, plain(value) if isinstance(value, Table) else value, source, where)
            if value is not None:
                self.problems = [each for each in self.problems if _fact(each[0]) != name]

    def errors(self, file: Path, sidecar: Path) -> list[ConfigurationError]:
        """Return an error of one line for each problem, with what to write."""
        found = []
        for fact, value, expected in self.problems:
            remedy = FACTS.get(_fact(fact))
            then = f"; write `{remedy}` in {sidecar.name}" if remedy else ""
            found.append(ConfigurationError(f"{file}: {fact}: {value}; expected {expected}{then}"))
        return found


def _fact(about: str) -> str:
    return about.partition(" ")[0].partition(".")[0]
