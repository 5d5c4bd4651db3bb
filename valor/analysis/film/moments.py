"""Messages of a bag at equidistant moments, read in one pass without storing others."""

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from valor.analysis.reading.recording import recorded
from valor.analysis.reading.ros_types import Types
from valor.bags.errors import BagError
from valor.bags.stored import StoredBag, StoredMessage
from valor.common.topics import CONTROLLERS, GROUND_TRUTH, MOTION_STATE, PROPRIOCEPTOR

JOINTS = (recorded(PROPRIOCEPTOR), "/joint_states")
STATE, TRUTH, ODOMETRY = recorded(MOTION_STATE), recorded(GROUND_TRUTH), "/odom"
CONTROLLER = recorded(CONTROLLERS)
TOPICS = (*JOINTS, STATE, TRUTH, ODOMETRY, CONTROLLER)
_MIRRORED = {JOINTS[0], STATE, TRUTH, CONTROLLER}  # of Bifrost's messages; the others are ROS 2's own
_ENCODING, _STAMPED = 4, 12  # bytes of the encoding header; of the stamp and the length of the frame's name
_AFTER = 2.0  # maximum delay of other topics after the last moment [s]
_TELL = 2000  # messages between two reports of progress

Moment = dict[str, Any]  # topic → its latest message


@dataclass(frozen=True)
class Moments:
    """Moments of a recording."""

    times: list[float]  # robot times [s]
    known: list[Moment]  # latest messages at each moment
    first: float  # robot time at the start of the recording [s]
    notices: list[str]  # damage of the part of the bag that was read


def read(path: Path, begin: float, end: float | None, step: float, check: Callable[[float], None]) -> Moments:
    """Read a bag's moments from ``begin`` to ``end``, since the start of the recording [s]; None: its end.

    ``check`` is called occasionally with the recorded time read [s], and may raise. Raises BagError: there is no bag,
    it has no joints, or it is shorter than ``begin``.
    """
    bag = StoredBag(path)
    samplers: dict[str, _Sampler] = {}
    types = Types()
    first = newest = -1.0
    for number, message in enumerate(bag.messages()):
        name = message.topic.name
        if name not in TOPICS:
            continue
        time = _time(message)
        if name in JOINTS:
            first, newest = (time if first < 0.0 else first), max(newest, time)
            if end is not None and newest > first + end + _AFTER:
                break
        if first < 0.0:
            continue
        if name not in samplers:
            samplers[name] = _Sampler(first + begin, step, partial(types.decode, message.topic))
        samplers[name].add(time, message.data)
        if number % _TELL == 0:
            check(newest - first)
    if first < 0.0:
        raise BagError(f"{path}: no messages on {' or '.join(JOINTS)}; a film needs the joints' positions")
    until = newest if end is None else min(newest, first + end)
    if until < first + begin:
        raise BagError(f"{path}: nothing after {begin:g} s; the recording lasts {newest - first:.1f} s")
    count = int((until - first - begin) / step + 1e-9) + 1
    known: list[Moment] = [{} for _ in range(count)]
    for name, sampler in samplers.items():
        for moment, found in zip(known, sampler.until(count), strict=True):
            moment[name] = found
    return Moments([first + begin + step * i for i in range(count)], known, first, bag.condition.damage)


class _Sampler:
    """Latest message of a topic at each of many moments, ``step`` [s] apart from robot time ``begin`` [s]."""

    def __init__(self, begin: float, step: float, decode: Callable[[bytes], Any]) -> None:
        self._begin, self._step, self._decode = begin, step, decode
        self._last = b""
        self._found: list[Any] = []

    def add(self, time: float, message: bytes) -> None:
        """Add a message of a robot time [s], in order of time."""
        missing = math.ceil((time - self._begin) / self._step - 1e-9) - len(self._found)
        if missing > 0:
            self._found += [self._decode(self._last or message)] * missing
        self._last = message

    def until(self, count: int) -> list[Any]:
        """Messages at the first ``count`` moments; the last message stands for those after it."""
        missing = count - len(self._found)
        return self._found[:count] + ([self._decode(self._last)] * missing if missing > 0 else [])


def _time(message: StoredMessage) -> float:
    """Robot time of a message [s]: its header's stamp, or in mirrored Bifrost messages the second number after it."""
    data = message.data
    order = "<" if len(data) > 1 and data[1] & 1 else ">"
    try:
        seconds, nanoseconds, length = struct.unpack_from(f"{order}iII", data, _ENCODING)
        if message.topic.name in _MIRRORED:
            behind = -(-(_STAMPED + length) // 8) * 8  # numbers of eight bytes are aligned to eight
            nanoseconds, seconds = struct.unpack_from(f"{order}q", data, _ENCODING + behind + 8)[0], 0
    except struct.error:
        raise BagError(f"{message.topic.name}: not {message.topic.type}: too short") from None
    time: float = seconds + 1e-9 * nanoseconds
    return time
