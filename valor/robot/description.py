"""Robot description: the content of ``robot.yaml``, next to ``model.xml`` (MJCF) in a robot's folder.

Limits are defined in ``robot.yaml`` and written into the models that ``valor.robot.model`` compiles from both.
"""

import contextlib
from collections.abc import Iterable
from pathlib import Path
from typing import Self, TypeVar, cast

import numpy as np
import numpy.typing as npt
from msgspec import structs

from valor.common.arrays import FloatArray
from valor.common.document import Document
from valor.common.errors import ConfigurationError, SeveralFaultsError
from valor.common.table import Table, TableError, checked, faults
from valor.robot.checks.tables import devices_are_complete, violations
from valor.robot.size import Size, completed, factors
from valor.robot.tables import Feet, RobotTables

T = TypeVar("T", bound=Table)
_PERIOD_TOLERANCE = 1e-9  # [s]


class _Proportions(Table, forbid_unknown_fields=False):
    """Keys that determine the scaled defaults."""

    size: Size
    feet: Feet

    def factors(self) -> dict[str, float]:
        """Return the scale factors of the defaults by dimension."""
        return factors(self.size, min(self.feet.left.half_width, self.feet.right.half_width))


def read_tables(file: Path) -> RobotTables:
    """Read a robot.yaml, with the defaults of its size. Raises ConfigurationError: a line for each fault."""
    document = Document.load(file)
    content = document.content
    with contextlib.suppress(TableError):  # reported below with all other faults
        content = completed(RobotTables, content, checked(_Proportions, content).factors())
    SeveralFaultsError.require_none(document.error(each.path, each.what) for each in faults(RobotTables, content))
    return checked(RobotTables, content)


class RobotDescription:
    """Tables of a robot and values derived from them; ``joints`` is the order of every joint vector, length n."""

    def __init__(self, folder: Path, tables: RobotTables, checked: bool = True) -> None:
        """Check and store the tables of a folder; ConfigurationError with a line for each fault, if ``checked``."""
        self.folder = folder
        self.tables = tables
        self.joints: tuple[str, ...] = tuple(tables.joints)
        self.index = {name: i for i, name in enumerate(self.joints)}
        rows = tables.joints.values()
        # (n,) each; continuous joints have the limits -inf and inf.
        self.lower: FloatArray = np.array([-np.inf if each.lower is None else each.lower for each in rows])  # [rad]
        self.upper: FloatArray = np.array([np.inf if each.upper is None else each.upper for each in rows])  # [rad]
        self.velocity_limit: FloatArray = np.array([each.velocity for each in rows])  # [rad/s]
        self.effort_limit: FloatArray = np.array([each.effort for each in rows])  # [N·m]
        self.servo_stiffness: FloatArray = np.array([each.servo.stiffness for each in rows])  # [N·m/rad]
        self.servo_damping: FloatArray = np.array([each.servo.damping for each in rows])  # [N·m·s/rad]
        self.nominal_posture: FloatArray = np.array([tables.nominal_posture.get(name, 0.0) for name in self.joints])
        self._read: dict[type[Table], Table] = {}
        if checked:
            self._require_none(violations(tables))

    @classmethod
    def load(cls, folder: Path, control_rate: float | None = None) -> Self:
        """Read a robot's folder, with another control rate [Hz] than robot.yaml's.

        Raises ConfigurationError: the folder, a file or a key is missing or invalid.
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
        """Read sections of robot.yaml, whose names are the fields of ``kind``, a table of their reader; cached.

        Raises ConfigurationError: a key is missing or invalid; a line for each, with file, line and key.
        """
        if (table := self._read.get(kind)) is None:
            sections = {name: getattr(self.tables, name) for name in kind.__struct_fields__}
            proportions = _Proportions(size=self.tables.size, feet=self.tables.feet)
            content = completed(kind, sections, proportions.factors())
            self._require_none(faults(kind, content))
            table = self._read[kind] = checked(kind, content)
        return cast("T", table)

    def error(self, path: Iterable[str], what: str) -> ConfigurationError:
        """Return an error about a key of robot.yaml, with its line and column."""
        keys = tuple(path)
        try:
            return Document.load(self.file).error(keys, what)
        except ConfigurationError:  # tables without a file
            return ConfigurationError(f"{self.file}: {'.'.join(keys)}: {what}")

    def _require_none(self, found: Iterable[TableError]) -> None:
        SeveralFaultsError.require_none(self.error(each.path, each.what) for each in found)

    def require_devices(self) -> None:
        """Raise ConfigurationError unless ``devices`` move all joints, and measure attitude and forces at the feet."""
        self._require_none(devices_are_complete(self.tables))

    @property
    def file(self) -> Path:
        """Path of robot.yaml."""
        return self.folder / "robot.yaml"

    @property
    def name(self) -> str:
        """Name of the robot."""
        return self.tables.name

    @property
    def model_file(self) -> Path:
        """Path of the MJCF file."""
        return self.folder / self.tables.model

    @property
    def control_period(self) -> float:
        """Control period [s]."""
        return 1.0 / self.tables.control_rate

    def physics_steps(self) -> int:
        """Return the number of physics steps in a control period. Raises ConfigurationError unless it is an integer."""
        period, step = self.control_period, self.tables.physics_step
        steps = round(period / step)
        if steps < 1 or abs(steps * step - period) > _PERIOD_TOLERANCE:
            what = f"got {step:g} s; expected a whole number of them in a control period of {period:g} s"
            raise self.error(["physics_step"], what)
        return steps

    def group_indices(self, group: str) -> npt.NDArray[np.intp]:
        """Return the indices of a group's joints in every joint vector; (0,) if the robot lacks the limb."""
        return np.array([self.index[name] for name in self.tables.group(group)], dtype=np.intp)

    def arms(self) -> list[npt.NDArray[np.intp]]:
        """Return the indices of each arm's joints in every joint vector; of the arms that the robot has."""
        return [self.group_indices(arm) for arm in ("left_arm", "right_arm") if self.tables.group(arm)]

    def frame_of(self, target: str) -> str:
        """Return the ROS frame of a body or site: its name in ``link_frames``, else its own."""
        return {name: frame for frame, name in self.tables.link_frames.items()}.get(target, target)
