"""Packed footsteps: integers, each as the difference to the same foot's last step, so that a steady walk is short."""

import copy
import zlib
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from rclpy.serialization import deserialize_message, serialize_message
from vigir_footstep_planning_msgs.msg import Step

from valor.link.errors import SealError
from valor.link.fields import from_smallest_three, smallest_three

POSITION = 1e-3  # [m]
TURN = 1.0 / 4096.0  # quaternion component
DURATION = 1e-3  # [s]
MOST = 1000  # steps of a plan
_LARGEST = 2**30  # absolute value, exclusive
_COLUMNS = 13

Numbers = npt.NDArray[np.int64]


def pack(steps: Sequence[Step]) -> bytes | None:
    """Packed steps, to half a millimetre. None if they differ in other fields, or a number is out of range."""
    if not steps:
        return b""
    rows, bare = [], [_without_numbers(step) for step in steps]
    for step in steps:
        row = _numbers(step)
        if not np.isfinite(row).all() or np.abs(row).max() >= _LARGEST:
            return None
        rows.append(np.rint(row))
    if len(steps) > MOST or any(each != bare[0] for each in bare):
        return None
    table = np.array(rows, dtype=np.int64)
    changes = table.copy()
    changes[2:] -= table[:-2]
    alike = serialize_message(bare[0])  # its padding is not initialised: never compared
    return _deflated(len(alike).to_bytes(2, "big") + alike + b"".join(map(varint, changes.T.reshape(-1).tolist())))


def unpack(data: bytes) -> list[Step]:
    """Inverse of ``pack``. Raises SealError: malformed."""
    if not data:
        return []
    try:
        content = zlib.decompressobj(-15).decompress(data, 1 << 20)
        size = int.from_bytes(content[:2], "big")
        bare = deserialize_message(content[2 : 2 + size], Step)
        changes = np.array(varints(content, 2 + size)[0], dtype=np.int64).reshape(_COLUMNS, -1).T
    except Exception as error:  # of zlib, NumPy and rclpy
        raise SealError(f"steps: {' '.join(str(error).split())}") from None
    table = changes.copy()
    for place in range(2, len(table)):
        table[place] += table[place - 2]
    if len(table) > MOST or np.abs(table).max() >= _LARGEST:
        raise SealError("steps: a number is too large")
    return [_step(bare, row) for row in table]


def _without_numbers(step: Step) -> Step:
    bare = copy.copy(step)
    bare.step_index, bare.swing_height, bare.sway_duration, bare.step_duration = 0, 0.0, 0.0, 0.0
    bare.foot = type(step.foot)(header=step.foot.header)
    bare.valid = False
    return bare


def _numbers(step: Step) -> npt.NDArray[np.float64]:
    """(13,) in the units of this file."""
    p, q = step.foot.pose.position, step.foot.pose.orientation
    turned = (q.w, q.x, q.y, q.z)
    components, largest = smallest_three(turned)
    known = 1.0 if any(turned) else 0.0
    return np.array((
        step.step_index, step.foot.foot_index, step.valid, p.x / POSITION, p.y / POSITION, p.z / POSITION, known,
        largest, *(components / TURN), step.swing_height / POSITION,
        round(step.sway_duration / DURATION) * 2**16 + round(step.step_duration / DURATION)
        if 0.0 <= step.sway_duration < 10.0 and 0.0 <= step.step_duration < 60.0 else np.nan,
    ))  # fmt: skip


def _step(bare: Step, row: Numbers) -> Step:
    step = copy.deepcopy(bare)
    index, foot, valid, x, y, z, known, largest = (int(each) for each in row[:8])
    if not (-(2**31) <= index < 2**31 and 0 <= foot < 256 and 0 <= largest < 4 and row[12] >= 0):
        raise SealError("steps: a number is out of range")
    step.step_index, step.foot.foot_index, step.valid = index, foot, bool(valid)
    position, q = step.foot.pose.position, step.foot.pose.orientation
    position.x, position.y, position.z = x * POSITION, y * POSITION, z * POSITION
    turned = from_smallest_three(np.asarray(row[8:11] * TURN, dtype=np.float64), largest) if known else np.zeros(4)
    q.w, q.x, q.y, q.z = map(float, turned)
    step.swing_height = float(row[11]) * POSITION
    sway, swing = divmod(int(row[12]), 2**16)
    step.sway_duration, step.step_duration = sway * DURATION, swing * DURATION
    return step


def _deflated(data: bytes) -> bytes:
    deflate = zlib.compressobj(9, zlib.DEFLATED, -15, 9)
    return deflate.compress(data) + deflate.flush()


def varint(number: int) -> bytes:
    rest = number << 1 if number >= 0 else ~(number << 1)
    found = bytearray()
    while rest >= 0x80:
        found.append(rest & 0x7F | 0x80)
        rest >>= 7
    found.append(rest)
    return bytes(found)


def varints(data: bytes, at: int = 0, count: int | None = None) -> tuple[list[int], int]:
    """Decode ``count`` numbers from ``at`` on, or all; also returns the index of their end.

    Raises SealError: a number longer than 63 bits, or fewer numbers.
    """
    found: list[int] = []
    number = shift = 0
    while at < len(data) and len(found) != count:
        byte = data[at]
        at += 1
        number |= (byte & 0x7F) << shift
        shift += 7
        if byte < 0x80:
            found.append(number >> 1 if not number & 1 else ~(number >> 1))
            number = shift = 0
        elif shift > 63:
            raise SealError("a number is too long")
    if count is not None and len(found) < count:
        raise SealError(f"{len(found)} numbers; expected {count}")
    return found, at
