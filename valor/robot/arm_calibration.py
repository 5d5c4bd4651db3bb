"""``calibration/arms.yaml``, by ``valorctl calibrate arm``: parameters of the arms that replace robot.yaml's."""

import contextlib
import hashlib
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Annotated

import msgspec
import yaml
from msgspec import Meta

from valor.common import whole_file
from valor.common.errors import ConfigurationError
from valor.common.table import NonNegative, Table, TableError, plain, read
from valor.robot.description import RobotDescription
from valor.robot.tables import SIDES

FILE = "calibration/arms.yaml"  # in the robot's folder
ANEW = "calibrate again (valorctl calibrate arm), or delete the file"

WIDEST_PLAY = 0.3  # [rad]
_HEAD = """\
# Parameters of the arms' drives and links, identified by `valorctl calibrate arm`. The Motion Manager reads them at
# startup; without this file it uses nominal values. Units: m, kg, rad, N·m, N·m·s/rad.
"""


class JointCalibration(Table, kw_only=True):
    """Drive of a joint."""

    friction: NonNegative  # Coulomb, at the joint [N·m]
    damping: NonNegative  # total viscous damping [N·m·s/rad]
    offset: float  # constant offset of the measured torque [N·m]
    backlash: Annotated[float, Meta(ge=0, le=WIDEST_PLAY)] | None = None  # peak to peak [rad]; None: unknown
    effort_share: Annotated[float, Meta(ge=0, le=1)]  # share of Motor's effort that the device applies
    strength: Annotated[float, Meta(gt=0, le=2)]  # effective share of the servo's gains
    residual: NonNegative  # RMS of the unexplained torque [N·m]


class LinkCalibration(Table, kw_only=True):
    """Body of an arm."""

    mass: Annotated[float, Meta(gt=0, le=100)]  # [kg]
    com: Annotated[list[Annotated[float, Meta(ge=-2, le=2)]], Meta(min_length=3, max_length=3)]  # in the body [m]


class ArmCalibration(Table, kw_only=True):
    """Calibration of one arm."""

    poses: Annotated[int, Meta(ge=1)]
    samples: Annotated[int, Meta(ge=1)]
    joints: dict[str, JointCalibration]
    links: dict[str, LinkCalibration]


class ArmCalibrations(Table, kw_only=True):
    """Content of the file."""

    robot: str
    fits: str  # ``fingerprint`` of the calibrated robot
    left_arm: ArmCalibration | None = None
    right_arm: ArmCalibration | None = None

    def present(self) -> Iterator[tuple[str, ArmCalibration]]:
        """Yield group and table of each calibrated arm, left first."""
        for side in SIDES:
            if (arm := getattr(self, f"{side}_arm")) is not None:
                yield f"{side}_arm", arm

    def joints(self) -> dict[str, JointCalibration]:
        """Return the joints of all arms by name."""
        return {name: joint for _, arm in self.present() for name, joint in arm.joints.items()}

    def links(self) -> dict[str, LinkCalibration]:
        """Return the links of all arms by body."""
        return {name: link for _, arm in self.present() for name, link in arm.links.items()}


def fingerprint(robot: RobotDescription) -> str:
    """Return a hash of the model file and the arms' joints in robot.yaml, 16 hex digits."""
    try:
        found = hashlib.blake2b(robot.model_file.read_bytes(), digest_size=8)
    except OSError as error:
        raise robot.error(["model"], f"{robot.model_file}: {error.strerror}") from None
    for side in SIDES:
        joints = robot.tables.group(f"{side}_arm")
        found.update(msgspec.json.encode([(name, plain(robot.tables.joints[name])) for name in joints]))
    return found.hexdigest()


def load(robot: RobotDescription) -> ArmCalibrations | None:
    """Return a robot's calibration, or None. Raises ConfigurationError if it is invalid or of another robot."""
    file = robot.folder / FILE
    return read(ArmCalibrations, file, partial(_violations, robot)) if file.is_file() else None


def joined(robot: RobotDescription, arms: dict[str, ArmCalibration]) -> ArmCalibrations:
    """Return new calibrations by group, merged with those of other arms that still fit."""
    kept: dict[str, ArmCalibration] = {}
    with contextlib.suppress(ConfigurationError):
        kept = dict(before.present()) if (before := load(robot)) else {}
    return ArmCalibrations(robot=robot.name, fits=fingerprint(robot), **(kept | arms))


def text(table: ArmCalibrations) -> str:
    """Return the content of the file."""
    content = {key: value for key, value in plain(table).items() if value is not None}
    for group, _ in table.present():
        for joint in content[group]["joints"].values():
            if joint["backlash"] is None:
                del joint["backlash"]
    return _HEAD + yaml.safe_dump(content, sort_keys=False, width=200, default_flow_style=None)


def require_writable(robot: RobotDescription) -> None:
    """Raise ConfigurationError if ``write`` is impossible."""
    file = robot.folder / FILE
    try:
        with tempfile.TemporaryFile(dir=file.parent if file.parent.exists() else robot.folder):
            pass
    except OSError as error:
        raise ConfigurationError(f"{file}: cannot be written: {error.strerror}") from None


def write(robot: RobotDescription, table: ArmCalibrations) -> Path:
    """Write the file into a robot's folder atomically. Raises ConfigurationError if that fails."""
    file = robot.folder / FILE
    try:
        file.parent.mkdir(exist_ok=True)
        whole_file.write(file, text(table))
    except OSError as error:
        raise ConfigurationError(f"{file}: cannot be written: {error.strerror}") from None
    return file


def _violations(robot: RobotDescription, table: ArmCalibrations) -> Iterator[TableError]:
    if table.robot != robot.name:
        yield TableError(("robot",), f"got {table.robot!r}; expected {robot.name!r}")
    for group, arm in table.present():
        joints = robot.tables.group(group)
        if set(arm.joints) != set(joints):
            got, expected = (", ".join(names) or "none" for names in (arm.joints, joints))
            yield TableError((group, "joints"), f"got {got}; expected {expected}: {ANEW}")
        for name, joint in arm.joints.items():
            if name in robot.index and joint.friction > (limit := robot.tables.joints[name].effort):
                what = f"got {joint.friction:g} N·m; expected at most the joint's effort limit, {limit:g} N·m"
                yield TableError((group, "joints", name, "friction"), what)
    if table.fits != (fits := fingerprint(robot)):
        what = f"got {table.fits}; expected {fits}: model.xml or the arms' joints in robot.yaml changed: {ANEW}"
        yield TableError(("fits",), what)
