"""``get_up.yaml``: how a robot gets up from where it may lie. Made offline, by optimisation (``valor.planning``)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Annotated

from msgspec import Meta

from valor.common.table import NonNegative, Positive, Table, TableError, read
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription

FILE = "get_up.yaml"  # in the robot's folder

Angle = Annotated[float, Meta(ge=-180, le=180)]
"""Of the pelvis [deg]."""


class KeyPose(Table, kw_only=True):
    """Where joints go, how long they take, and how the pelvis is to lie or stand afterwards."""

    name: str
    duration: Positive  # [s]
    hold: NonNegative = 0.0  # then [s]
    pitch: Annotated[list[Angle], Meta(min_length=2, max_length=2)]  # of the pelvis afterwards, from and to [deg]
    balanced: bool = False  # on the way there and in the hold, by `balance`
    joints: dict[str, float]  # [rad]; the others stay where the pose before had them

    def __post_init__(self) -> None:
        if self.pitch[0] >= self.pitch[1]:
            raise TableError(("pitch",), f"got {self.pitch[0]:g} to {self.pitch[1]:g}; expected from less to more")


class Balance(Table):
    """How a robot on both soles keeps its CoM above them: proportional to the DCM ahead of their middle."""

    joints: Annotated[list[str], Meta(min_length=1)]  # the ankles, whose positive angle lowers the toes
    gain: Positive  # [rad/m]
    limit: Positive  # of the angle added [rad]


class GetUpTable(Table):
    """The file as a whole."""

    roll: Annotated[float, Meta(gt=0, le=180)]  # of the pelvis, at most [deg]
    balance: Balance
    face_down: Annotated[list[KeyPose], Meta(min_length=1)]


def load(robot: RobotDescription) -> GetUpTable | None:
    """A robot's table; None: it has none, and does not get up.

    Raises:
        ConfigurationError: the file or a key is wrong, or of another robot; in one line with file, line and key.
    """
    file = robot.folder / FILE
    if not file.is_file():
        return None
    table = read(GetUpTable, file)
    for broken in _strange(robot, table):
        from valor.common.document import Document

        raise Document.load(file).error(broken.path, broken.what)
    return table


def _strange(robot: RobotDescription, table: GetUpTable) -> Iterator[TableError]:
    """What the robot does not have, or cannot do."""
    limits = CommandedLimits.of_joints(robot)
    yield from _unknown(robot, ("balance", "joints"), table.balance.joints)
    for i, pose in enumerate(table.face_down):
        path = ("face_down", str(i), "joints")
        yield from _unknown(robot, path, pose.joints)
        for name, position in pose.joints.items():
            lower, upper = limits.lower[robot.index[name]], limits.upper[robot.index[name]]
            if not lower <= position <= upper:
                yield TableError((*path, name), f"got {position:g} rad; expected {lower:g} to {upper:g}")


def _unknown(robot: RobotDescription, path: tuple[str, ...], names: Iterable[str]) -> Iterator[TableError]:
    for name in names:
        if name not in robot.index:
            yield TableError(path, f"unknown joint {name!r}; expected one of {robot.name}'s")
