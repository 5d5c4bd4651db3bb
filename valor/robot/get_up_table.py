"""``get_up.yaml``: the key poses of Get Up. Generated offline by ``valor.get_up_planning``."""

from collections.abc import Iterable, Iterator
from functools import partial
from typing import Annotated

from msgspec import Meta

from valor.common.arrays import FloatArray
from valor.common.table import NonNegative, Positive, Table, TableError, read
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription
from valor.robot.posture_move import PostureMove

FILE = "get_up.yaml"  # in the robot's folder
_ROUNDING = 0.01  # of durations in the file [s]

Angle = Annotated[float, Meta(ge=-180, le=180)]
"""Of the pelvis [deg]."""


class KeyPose(Table, kw_only=True):
    """Joint angles of a pose, its timing, and the pelvis pitch afterwards."""

    name: str
    duration: Annotated[float, Meta(ge=0.1, le=60, extra={"unit": "s"})]  # at least as its joints' limits require [s]
    hold: NonNegative = 0.0  # after arrival [s]
    pitch: Annotated[list[Angle], Meta(min_length=2, max_length=2)]  # of the pelvis afterwards, from and to [deg]
    balanced: bool = False  # with `balance` during motion and hold
    joints: dict[str, float]  # [rad]; default: as in the previous pose

    def __post_init__(self) -> None:
        if self.pitch[0] >= self.pitch[1]:
            raise TableError(("pitch",), f"got {self.pitch[0]:g} to {self.pitch[1]:g}; expected from less to more")


class Balance(Table):
    """Balance on both soles: ankle angle proportional to the DCM ahead of the middle of the soles."""

    joints: Annotated[list[str], Meta(min_length=1)]  # ankle joints; a positive angle lowers the toes
    gain: Positive  # [rad/m]
    limit: Positive  # of the added angle [rad]


class GetUpTable(Table):
    """Content of the file."""

    roll: Annotated[float, Meta(gt=0, le=180)]  # of the pelvis, at most [deg]
    balance: Balance
    face_down: Annotated[list[KeyPose], Meta(min_length=1)]


def load(robot: RobotDescription) -> GetUpTable | None:
    """Return a robot's table, or None if it cannot get up. Raises ConfigurationError with file, line and key."""
    file = robot.folder / FILE
    return read(GetUpTable, file, partial(_violations, robot)) if file.is_file() else None


def _violations(robot: RobotDescription, table: GetUpTable) -> Iterator[TableError]:
    limits = CommandedLimits.of_joints(robot)
    before: FloatArray | None = None
    yield from _unknown(robot, ("balance", "joints"), table.balance.joints)
    for i, pose in enumerate(table.face_down):
        path = ("face_down", str(i), "joints")
        yield from _unknown(robot, path, pose.joints)
        if not set(pose.joints) <= set(robot.index):
            return
        posture = (robot.nominal_posture if before is None else before).copy()
        posture[[robot.index[name] for name in pose.joints]] = list(pose.joints.values())
        if before is not None:  # the first pose starts from any posture
            move = PostureMove(
                before, posture, velocity=limits.velocity, acceleration=limits.acceleration, began=0.0, shortest=0.0
            )
            if pose.duration < move.duration - _ROUNDING:
                what = (
                    f"got {pose.duration:g} s; expected at least {move.duration:.2f} s, as its joints' limits require"
                )
                yield TableError(("face_down", str(i), "duration"), what)
        before = posture
        for name, position in pose.joints.items():
            lower, upper = limits.lower[robot.index[name]], limits.upper[robot.index[name]]
            if not lower <= position <= upper:
                yield TableError((*path, name), f"got {position:g} rad; expected {lower:g} to {upper:g}")


def _unknown(robot: RobotDescription, path: tuple[str, ...], names: Iterable[str]) -> Iterator[TableError]:
    for name in names:
        if name not in robot.index:
            yield TableError(path, f"unknown joint {name!r}; expected one of {robot.name}'s")
