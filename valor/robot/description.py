"""The robot description: everything the code knows about a robot, read from its folder.

A robot is a folder with ``model.xml`` (MJCF: bodies, inertias, joints, geoms, sites) and ``robot.yaml`` (the tables of
``tables.py``). This module reads ``robot.yaml`` only; ``valor.robot.model`` makes MuJoCo models from the pair.
Limits live in ``robot.yaml`` and are written into the models from there, so that no number stands twice.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path
from typing import TypeVar, cast

import numpy as np
import numpy.typing as npt
from msgspec import structs

from valor.common.arrays import FloatArray
from valor.common.document import Document
from valor.common.errors import ConfigurationError, SeveralFaultsError
from valor.common.table import Table, TableError, checked, faults
from valor.robot.rules import broken_rules
from valor.robot.size import Size, completed, factors
from valor.robot.tables import Feet, RobotTables

T = TypeVar("T", bound=Table)
_PERIOD_TOLERANCE = 1e-9  # [s]


class _Proportions(Table, forbid_unknown_fields=False):
    """What must be known of a robot before its defaults are."""

    size: Size
    feet: Feet

    def factors(self) -> dict[str, float]:
        """Of its defaults, by dimension."""
        return factors(self.size, min(self.feet.left.half_width, self.feet.right.half_width))


def read_tables(file: Path) -> RobotTables:
    """The tables of a robot.yaml, with the defaults of its size.

    Raises:
        ConfigurationError: keys are missing or wrong; a line for each.
    """
    document = Document.load(file)
    content = document.content
    with contextlib.suppress(TableError):  # told with all others
        content = completed(RobotTables, content, checked(_Proportions, content).factors())
    SeveralFaultsError.require_none(document.error(each.path, each.what) for each in faults(RobotTables, content))
    return checked(RobotTables, content)


class RobotDescription:
    """A robot's tables with what follows from them.

    Attributes:
        folder: the robot's folder.
        tables: robot.yaml.
        joints: joint names, in the order of every joint vector, length n.
    """

    def __init__(self, folder: Path, tables: RobotTables, ruled: bool = True) -> None:
        """Of tables that fit each other.

        Args:
            folder: of the robot.
            tables: robot.yaml.
            ruled: whether they must keep the rules of ``rules.py``; without, only what is sound in them can be used.

        Raises:
            ConfigurationError: they break rules; a line for each fault.
        """
        self.folder = folder
        self.tables = tables
        self.joints: tuple[str, ...] = tuple(tables.joints)
        self._read: dict[type[Table], Table] = {}
        if ruled:
            SeveralFaultsError.require_none(self.error(each.path, each.what) for each in broken_rules(tables))

    @classmethod
    def load(cls, folder: Path, control_rate: float | None = None) -> RobotDescription:
        """Read a robot's folder.

        Args:
            folder: of the robot.
            control_rate: instead of robot.yaml's [Hz].

        Raises:
            ConfigurationError: the folder, a file or a key is missing or wrong.
        """
        file = folder / "robot.yaml"
        if not file.is_file():
            raise ConfigurationError(f"{file}: no such file; expected a robot's folder with robot.yaml")
        tables = read_tables(file)
        robot = cls(folder, tables)
        if not robot.model_file.is_file():
            raise robot.error(["model"], f"no file {robot.model_file}")
        return robot if control_rate is None else cls(folder, structs.replace(tables, control_rate=control_rate))

    def read(self, kind: type[T]) -> T:
        """Those sections of robot.yaml that a reader has a table of beside itself; read once.

        Args:
            kind: its keys are those of ``RobotTables`` that are a ``Section``.

        Raises:
            ConfigurationError: a key is missing or wrong; a line for each, with file, line and key.
        """
        if (table := self._read.get(kind)) is None:
            sections = {name: getattr(self.tables, name) for name in kind.__struct_fields__}
            proportions = _Proportions(size=self.tables.size, feet=self.tables.feet)
            content = completed(kind, sections, proportions.factors())
            SeveralFaultsError.require_none(self.error(each.path, each.what) for each in faults(kind, content))
            table = self._read[kind] = checked(kind, content)
        return cast("T", table)

    def error(self, path: Iterable[str], what: str) -> ConfigurationError:
        """One line that says what is wrong with a key of robot.yaml, and where it stands there."""
        keys = tuple(path)
        try:
            return Document.load(self.file).error(keys, what)
        except ConfigurationError:  # tables that were made otherwise
            return ConfigurationError(f"{self.file}: {'.'.join(keys)}: {what}")

    @property
    def file(self) -> Path:
        """robot.yaml."""
        return self.folder / "robot.yaml"

    @property
    def name(self) -> str:
        """The robot's name."""
        return self.tables.name

    @property
    def model_file(self) -> Path:
        """The MJCF file."""
        return self.folder / self.tables.model

    @property
    def control_period(self) -> float:
        """[s]."""
        return 1.0 / self.tables.control_rate

    def physics_steps(self) -> int:
        """Of a simulation, in a control period.

        Raises:
            ConfigurationError: they are no whole number.
        """
        period, step = self.control_period, self.tables.physics_step
        steps = round(period / step)
        if steps < 1 or abs(steps * step - period) > _PERIOD_TOLERANCE:
            what = f"got {step:g} s; expected a whole number of them in a control period of {period:g} s"
            raise self.error(["physics_step"], what)
        return steps

    @cached_property
    def index(self) -> dict[str, int]:
        """Joint name → place in every joint vector."""
        return {name: i for i, name in enumerate(self.joints)}

    def group_indices(self, group: str) -> npt.NDArray[np.intp]:
        """Places of a group's joints in every joint vector; (0,) where the robot has no such limb."""
        return np.array([self.index[name] for name in self.tables.group(group)], dtype=np.intp)

    def frame_of(self, target: str) -> str:
        """The ROS frame of a body or site of the model: as ``link_frames`` calls it, else its own name."""
        return {name: frame for frame, name in self.tables.link_frames.items()}.get(target, target)

    @cached_property
    def lower(self) -> FloatArray:
        """(n,) [rad]; -inf where a joint turns without end."""
        return np.array([-np.inf if j.lower is None else j.lower for j in self.tables.joints.values()])

    @cached_property
    def upper(self) -> FloatArray:
        """(n,) [rad]; inf where a joint turns without end."""
        return np.array([np.inf if j.upper is None else j.upper for j in self.tables.joints.values()])

    @cached_property
    def velocity_limit(self) -> FloatArray:
        """(n,) [rad/s]."""
        return np.array([j.velocity for j in self.tables.joints.values()])

    @cached_property
    def effort_limit(self) -> FloatArray:
        """(n,) [N·m]."""
        return np.array([j.effort for j in self.tables.joints.values()])

    @cached_property
    def servo_stiffness(self) -> FloatArray:
        """(n,) [N·m/rad]."""
        return np.array([j.servo.stiffness for j in self.tables.joints.values()])

    @cached_property
    def servo_damping(self) -> FloatArray:
        """(n,) [N·m·s/rad]."""
        return np.array([j.servo.damping for j in self.tables.joints.values()])

    @cached_property
    def nominal_posture(self) -> FloatArray:
        """(n,) [rad]."""
        return np.array([self.tables.nominal_posture.get(name, 0.0) for name in self.joints])
