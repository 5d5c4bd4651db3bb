"""What a bag says at moments that are evenly apart, read in one pass that keeps nothing else."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from valor.analysis.recording import recorded
from valor.analysis.ros_types import Types
from valor.bags.errors import BagError
from valor.bags.stored import StoredBag, StoredMessage, StoredTopic
from valor.common.topics import GROUND_TRUTH, MOTION_STATE, PROPRIOCEPTOR

JOINTS = (recorded(PROPRIOCEPTOR), "/joint_states")
STATE, TRUTH, ODOMETRY = recorded(MOTION_STATE), recorded(GROUND_TRUTH), "/odom"
TOPICS = (*JOINTS, STATE, TRUTH, ODOMETRY)
_TWINS = {JOINTS[0], STATE, TRUTH}  # of Bifrost's messages; the others are ROS 2's own
_ENCODING, _STAMPED = 4, 12  # bytes that say how a message is encoded; of its stamp, and of its frame's length
_AFTER = 2.0  # of the last moment, other topics may still say something of it [s]
_TELL = 2000  # messages between two words of how it goes on

Moment = dict[str, Any]  # topic → the newest message of it


@dataclass(frozen=True)
class Moments:
    """What was found.

    Attributes:
        times: robot times, one a moment [s].
        known: of each moment the newest message of every topic that says anything.
        first: robot time at which the recording begins [s].
        notices: what is wrong with the bag, as far as it was read.
    """

    times: list[float]
    known: list[Moment]
    first: float
    notices: list[str]


def read(path: Path, begin: float, end: float | None, step: float, check: Callable[[float], None]) -> Moments:
    """Read a bag.

    Args:
        path: a bag.
        begin: of the moments, after the recording's beginning [s].
        end: likewise; None: the recording's end.
        step: between moments [s].
        check: called now and then with how far it has been read [s]; may raise.

    Raises:
        BagError: no bag; no joints in it; it is shorter than ``begin``.
    """
    bag = StoredBag(path)
    samplers: dict[str, Sampler] = {}
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
        sampler = samplers.get(name)
        if sampler is None:
            decode = partial(_decode, types, message.topic, path)
            sampler = samplers[name] = Sampler(first + begin, step, decode)
        sampler.hear(time, message.data)
        if number % _TELL == 0:
            check(newest - first)
    if first < 0.0:
        raise BagError(f"{path}: no messages on {' or '.join(JOINTS)}; a film needs the joints' positions")
    until = newest if end is None else min(newest, first + end)
    if until < first + begin:
        raise BagError(f"{path}: nothing after {begin:g} s; the recording lasts {newest - first:.1f} s")
    found = gather(samplers, first, begin, until, step)
    return replace(found, notices=bag.condition.damage)


def gather(samplers: Mapping[str, Sampler], first: float, begin: float, until: float, step: float) -> Moments:
    """What samplers found by topic, from ``first + begin`` until a robot time [s]."""
    count = int((until - first - begin) / step + 1e-9) + 1
    known: list[Moment] = [{} for _ in range(count)]
    for name, sampler in samplers.items():
        for moment, found in zip(known, sampler.until(count), strict=True):
            moment[name] = found
    return Moments([first + begin + step * i for i in range(count)], known, first, [])


def _decode(types: Types, topic: StoredTopic, path: Path, data: bytes) -> Any:
    try:
        return types.decode(topic, data)
    except BagError as error:
        raise BagError(f"{path}: {error}") from None


class Sampler:
    """The newest message of a topic at each of many moments, decoded once.

    Args:
        begin: of the moments, robot time [s].
        step: between them [s].
        decode: of what is heard, the message.
    """

    def __init__(self, begin: float, step: float, decode: Callable[[Any], Any] = lambda message: message) -> None:
        self._begin, self._step, self._decode = begin, step, decode
        self._last: Any = None
        self._found: list[Any] = []

    def hear(self, time: float, message: Any) -> None:
        """A message of a robot time [s]; of what was before it nothing newer will come."""
        missing = math.ceil((time - self._begin) / self._step - 1e-9) - len(self._found)
        if missing > 0:
            self._found += [self._decode(message if self._last is None else self._last)] * missing
        self._last = message

    def until(self, count: int) -> list[Any]:
        """Of so many moments; the last message stands for those behind it."""
        missing = count - len(self._found)
        return self._found[:count] + ([self._decode(self._last)] * missing if missing > 0 else [])


def _time(message: StoredMessage) -> float:
    """Robot time of a message [s], without decoding the rest of it.

    The header's stamp; in the twins of Bifrost's messages, whose stamp is the wall's, the second number behind it.
    """
    data = message.data
    order = "<" if len(data) > 1 and data[1] & 1 else ">"
    try:
        seconds, nanoseconds, length = struct.unpack_from(f"{order}iII", data, _ENCODING)
        if message.topic.name in _TWINS:
            behind = -(-(_STAMPED + length) // 8) * 8  # numbers of eight bytes stand at multiples of eight
            nanoseconds, seconds = struct.unpack_from(f"{order}q", data, _ENCODING + behind + 8)[0], 0
    except struct.error:
        raise BagError(f"{message.topic.name}: not {message.topic.type}: too short") from None
    time: float = seconds + 1e-9 * nanoseconds
    return time
