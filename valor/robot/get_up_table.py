"""``get_up.yaml``: the motions between ways of lying, and to standing. ``valorctl robot get-up`` makes it."""

from collections.abc import Iterable, Iterator
from enum import StrEnum
from functools import partial
from math import asin, atan2, cos, degrees, radians
from typing import Annotated

from msgspec import Meta, field

from valor.common.arrays import FloatArray
from valor.common.table import NonNegative, Positive, Table, TableError, read
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription
from valor.robot.posture_move import PostureMove

FILE = "get_up.yaml"  # in the robot's folder
CRUISE = 0.7  # share of a motion at steady velocity, at most
_ROUNDING = 0.01  # of durations in the file [s]


UPRIGHT = cos(radians(35.0))  # the pelvis of a robot that does not lie points higher up
ON_ITS_SIDE = (40.0, 140.0)  # angle about the pelvis axis from lying on the back; outside: back, face [deg]


class Posture(StrEnum):
    """Ways of lying, and standing."""

    FACE = "face"
    BACK = "back"
    LEFT = "left"
    RIGHT = "right"
    STANDING = "standing"


def other(way: Posture) -> Posture:
    """Return the mirror image of a way of lying."""
    return {Posture.LEFT: Posture.RIGHT, Posture.RIGHT: Posture.LEFT}.get(way, way)


def attitude(vertical: Iterable[float]) -> tuple[float, float]:
    """Pitch of the pelvis, −180 to 180 (face-down: 90), and its roll, left side up positive, −90 to 90 [deg].

    ``vertical``: in the pelvis' axes.
    """
    forward, left, up = vertical
    return degrees(atan2(-forward, up)), degrees(asin(min(1.0, max(-1.0, left))))


def lying(vertical: Iterable[float]) -> Posture | None:
    """Return the way of lying for the vertical in the pelvis' axes; None if the robot does not lie."""
    forward, left, up = vertical
    if up > UPRIGHT:
        return None
    around = degrees(atan2(left, forward))  # 0 on the back, 90 on the right side
    if abs(around) < ON_ITS_SIDE[0]:
        return Posture.BACK
    if abs(around) > ON_ITS_SIDE[1]:
        return Posture.FACE
    return Posture.RIGHT if around > 0.0 else Posture.LEFT


Angle = Annotated[float, Meta(ge=-180, le=180)]
"""Of the pelvis [deg]."""


class KeyPose(Table, kw_only=True):
    """Joint angles of a pose, its timing, and the pelvis pitch afterwards."""

    name: str
    duration: Annotated[float, Meta(ge=0.1, le=60, extra={"unit": "s"})]  # at least as its joints' limits require [s]
    hold: NonNegative = 0.0  # after arrival [s]
    pitch: Annotated[list[Angle], Meta(min_length=2, max_length=2)] | None = None  # afterwards, from and to [deg]
    balanced: bool = False  # with `balance` during motion and hold
    joints: dict[str, float]  # [rad]; default: as in the previous pose

    def __post_init__(self) -> None:
        if self.pitch is not None and self.pitch[0] >= self.pitch[1]:
            raise TableError(("pitch",), f"got {self.pitch[0]:g} to {self.pitch[1]:g}; expected from less to more")


class Motion(Table, kw_only=True):
    """Key poses that change the way of lying. The mirrored motion starts from the other side."""

    start: Annotated[list[Posture], Meta(min_length=1)] = field(name="from")
    to: Posture
    poses: Annotated[list[KeyPose], Meta(min_length=1)]


class Balance(Table):
    """Balance on both soles: ankle angle proportional to the DCM ahead of the middle of the soles."""

    joints: Annotated[list[str], Meta(min_length=1)]  # ankle joints; a positive angle lowers the toes
    gain: Positive  # [rad/m]
    limit: Positive  # of the added angle [rad]


class GetUpTable(Table):
    """Content of the file."""

    roll: Annotated[float, Meta(gt=0, le=180)]  # of the pelvis after poses with a pitch, at most [deg]
    balance: Balance
    motions: Annotated[list[Motion], Meta(min_length=1)]


def goals(robot: RobotDescription, poses: Iterable[KeyPose]) -> list[FloatArray]:
    """Return the joint positions (n,) of each key pose [rad], from the nominal posture on."""
    posture, found = robot.nominal_posture, list[FloatArray]()
    for pose in poses:
        posture = posture.copy()
        posture[[robot.index[name] for name in pose.joints]] = list(pose.joints.values())
        found.append(posture)
    return found


def posture_move(
    limits: CommandedLimits, start: FloatArray, goal: FloatArray, shortest: float = 0.0, began: float = 0.0
) -> PostureMove:
    """Return the motion to a key pose ``goal`` (n,) from ``start`` (n,) [rad]; times [s]."""
    velocity, acceleration = limits.velocity, limits.acceleration
    return PostureMove(
        start, goal, velocity=velocity, acceleration=acceleration, began=began, shortest=shortest, cruise=CRUISE
    )


def load(robot: RobotDescription) -> GetUpTable | None:
    """Return a robot's table, or None if it cannot get up. Raises ConfigurationError with file, line and key."""
    file = robot.folder / FILE
    return read(GetUpTable, file, partial(_violations, robot)) if file.is_file() else None


def _violations(robot: RobotDescription, table: GetUpTable) -> Iterator[TableError]:
    yield from _unknown(robot, ("balance", "joints"), table.balance.joints)
    ways = {Posture.STANDING} | {
        way for motion in table.motions for start in motion.start for way in (start, other(start))
    }
    for i, motion in enumerate(table.motions):
        yield from _motion_violations(robot, ("motions", str(i), "poses"), motion.poses)
        if motion.to not in ways:
            yield TableError(
                ("motions", str(i), "to"), f"no motion starts from {motion.to}; expected a way to standing"
            )


def _motion_violations(robot: RobotDescription, at: tuple[str, ...], poses: Iterable[KeyPose]) -> Iterator[TableError]:
    limits = CommandedLimits.of_joints(robot)
    before: FloatArray | None = None
    for i, pose in enumerate(poses):
        path = (*at, str(i), "joints")
        yield from _unknown(robot, path, pose.joints)
        if not set(pose.joints) <= set(robot.index):
            return
        posture = (robot.nominal_posture if before is None else before).copy()
        posture[[robot.index[name] for name in pose.joints]] = list(pose.joints.values())
        if before is not None:  # the first pose starts from any posture
            move = posture_move(limits, before, posture)
            if pose.duration < move.duration - _ROUNDING:
                what = (
                    f"got {pose.duration:g} s; expected at least {move.duration:.2f} s, as its joints' limits require"
                )
                yield TableError((*at, str(i), "duration"), what)
        before = posture
        for name, position in pose.joints.items():
            lower, upper = limits.lower[robot.index[name]], limits.upper[robot.index[name]]
            if not lower <= position <= upper:
                yield TableError((*path, name), f"got {position:g} rad; expected {lower:g} to {upper:g}")


def _unknown(robot: RobotDescription, path: tuple[str, ...], names: Iterable[str]) -> Iterator[TableError]:
    for name in names:
        if name not in robot.index:
            yield TableError(path, f"unknown joint {name!r}; expected one of {robot.name}'s")
