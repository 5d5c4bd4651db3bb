"""``calibration/arms.yaml``: what was found of the arms' drives and links. Made by ``valorctl calibrate arm``.

It stands beside robot.yaml and goes before its nominal numbers; a robot without it goes by those. Words are those of
``Gear`` in ``tables.py``.
"""

from __future__ import annotations

import contextlib
import hashlib
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal, get_args

import msgspec
import yaml
from msgspec import Meta

from valor.common import whole_file
from valor.common.document import Document
from valor.common.errors import ConfigurationError
from valor.common.table import NonNegative, Table, TableError, plain, read
from valor.robot.description import RobotDescription

FILE = "calibration/arms.yaml"  # in the robot's folder
ANEW = "calibrate anew (valorctl calibrate arm), or delete the file"

Side = Literal["left", "right"]
SIDES: tuple[Side, ...] = get_args(Side)
WIDEST_PLAY = 0.3  # [rad]
_HEAD = """\
# What `valorctl calibrate arm` found of the arms' drives and links. The Motion Manager reads it when it starts, and
# goes by nominal numbers without it. Units: m, kg, rad, N·m, N·m·s/rad.
"""


class JointCalibration(Table, kw_only=True):
    """A joint's drive."""

    friction: NonNegative  # Coulomb, at the joint [N·m]
    damping: NonNegative  # viscous, all of it [N·m·s/rad]
    offset: float  # of the measured torque, in every posture [N·m]
    backlash: Annotated[float, Meta(ge=0, le=WIDEST_PLAY)] | None = None  # peak to peak [rad]; absent: did not show
    effort_share: Annotated[float, Meta(ge=0, le=1)]  # of Motor's effort that the device takes
    strength: Annotated[float, Meta(gt=0, le=2)]  # share of the servo's gains that acts
    residual: NonNegative  # torque that all this leaves unexplained, RMS [N·m]


class LinkCalibration(Table, kw_only=True):
    """A body of the model that moves with a joint of the arm."""

    mass: Annotated[float, Meta(gt=0, le=100)]  # [kg]
    com: Annotated[list[Annotated[float, Meta(ge=-2, le=2)]], Meta(min_length=3, max_length=3)]  # in the body [m]


class ArmCalibration(Table, kw_only=True):
    """One arm: what it was found from, and what was found."""

    poses: Annotated[int, Meta(ge=1)]
    samples: Annotated[int, Meta(ge=1)]
    joints: dict[str, JointCalibration]
    links: dict[str, LinkCalibration]


class ArmCalibrations(Table, kw_only=True):
    """The file as a whole."""

    robot: str
    fits: str  # of what it was found for: see ``fingerprint``
    left_arm: ArmCalibration | None = None
    right_arm: ArmCalibration | None = None

    def present(self) -> Iterator[tuple[str, ArmCalibration]]:
        """Group and table of each arm that was calibrated, left first."""
        for side in SIDES:
            if (arm := getattr(self, f"{side}_arm")) is not None:
                yield f"{side}_arm", arm

    def joints(self) -> dict[str, JointCalibration]:
        """Of all arms, by name."""
        return {name: joint for _, arm in self.present() for name, joint in arm.joints.items()}

    def links(self) -> dict[str, LinkCalibration]:
        """Of all arms, by body."""
        return {name: link for _, arm in self.present() for name, link in arm.links.items()}


def fingerprint(robot: RobotDescription) -> str:
    """What a calibration stands on, in 16 digits: the model, and the arms' joints as robot.yaml has them.

    Raises:
        ConfigurationError: the model's file cannot be read.
    """
    try:
        found = hashlib.blake2b(robot.model_file.read_bytes(), digest_size=8)
    except OSError as error:
        raise robot.error(["model"], f"{robot.model_file}: {error.strerror}") from None
    for side in SIDES:
        joints = robot.tables.group(f"{side}_arm")
        found.update(msgspec.json.encode([(name, plain(robot.tables.joints[name])) for name in joints]))
    return found.hexdigest()


def load(robot: RobotDescription) -> ArmCalibrations | None:
    """A robot's calibration; None: it has none, and goes by nominal numbers.

    Raises:
        ConfigurationError: the file or a key is wrong, or it is not of this robot as it is; in one line with file,
            line and key.
    """
    file = robot.folder / FILE
    if not file.is_file():
        return None
    table = read(ArmCalibrations, file)
    for broken in _strange(robot, table):
        raise Document.load(file).error(broken.path, broken.what)
    return table


def joined(robot: RobotDescription, arms: dict[str, ArmCalibration]) -> ArmCalibrations:
    """What a robot's file is to say once arms were calibrated: of the others what it says, if that still fits.

    Args:
        robot: whose arms.
        arms: what was found, by group.

    Raises:
        ConfigurationError: as of ``fingerprint``.
    """
    kept: dict[str, ArmCalibration] = {}
    with contextlib.suppress(ConfigurationError):
        kept = dict(before.present()) if (before := load(robot)) else {}
    return ArmCalibrations(robot=robot.name, fits=fingerprint(robot), **(kept | arms))


def text(table: ArmCalibrations) -> str:
    """The file's content."""
    content = {key: value for key, value in plain(table).items() if value is not None}
    for group, _ in table.present():
        for joint in content[group]["joints"].values():
            if joint["backlash"] is None:
                del joint["backlash"]
    return _HEAD + yaml.safe_dump(content, sort_keys=False, width=200, default_flow_style=None)


def require_writable(robot: RobotDescription) -> None:
    """See whether ``write`` can.

    Raises:
        ConfigurationError: it cannot; names the file.
    """
    file = robot.folder / FILE
    try:
        with tempfile.TemporaryFile(dir=file.parent if file.parent.exists() else robot.folder):
            pass
    except OSError as error:
        raise ConfigurationError(f"{file}: cannot be written: {error.strerror}") from None


def write(robot: RobotDescription, table: ArmCalibrations) -> Path:
    """Put the file into a robot's folder, whole or not at all; it is read when a process starts.

    Raises:
        ConfigurationError: it cannot be written; names it.
    """
    file = robot.folder / FILE
    try:
        file.parent.mkdir(exist_ok=True)
        whole_file.write(file, text(table))
    except OSError as error:
        raise ConfigurationError(f"{file}: cannot be written: {error.strerror}") from None
    return file


def _strange(robot: RobotDescription, table: ArmCalibrations) -> Iterator[TableError]:
    """What does not fit the robot."""
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
        what = f"got {table.fits}; expected {fits}: model.xml or the arms' joints in robot.yaml are others: {ANEW}"
        yield TableError(("fits",), what)
