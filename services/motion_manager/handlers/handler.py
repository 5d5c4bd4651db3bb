"""Base classes of the handlers, counter of rejected commands, and common checks."""

from __future__ import annotations

import logging
import time
from abc import ABC, abstractmethod
from collections.abc import Container, Iterator, Sequence
from math import hypot, isfinite
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

import numpy as np

from bifrost import Message, Received
from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.common.errors import RefusalError
from valor.common.messages import Rejection
from valor.common.topics import ServiceTopic, Topic
from valor.motion_manager.discovery import classes

if TYPE_CHECKING:
    from valor.motion_manager.components import Components

STALE = 0.5  # largest age of the state that a command was made for [s of robot time]
PERIOD = 0.2  # between published rejections of one kind from one sender [s]
_KINDS = 256  # stored; more, and all are discarded

_log = logging.getLogger("motion_manager")

M = TypeVar("M", bound=Message)
Q = TypeVar("Q", bound=Message)
R = TypeVar("R", bound=Message)


class RejectionCounter:
    """Counts rejections by topic, and stores those to publish; ``total``: number since start."""

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}
        self._published: dict[tuple[str, str, str], float] = {}
        self._waiting: list[Rejection] = []
        self.total = 0

    def add(self, topic: str, origin: str, kind: str, reason: str) -> None:
        """Count a rejection of the node ``origin``; each ``kind`` (one word) is published at a bounded rate."""
        self.total += 1
        count = self._counts[topic] = self._counts.get(topic, 0) + 1
        now = time.monotonic()
        key = (topic, origin, kind)
        if now - self._published.get(key, -PERIOD) < PERIOD:
            return
        if key not in self._published:
            if len(self._published) >= _KINDS:
                self._published.clear()
            _log.warning("%s from %s rejected: %s", topic, origin, reason)
        self._published[key] = now
        self._waiting.append(Rejection(topic=topic, origin=origin, reason=reason, count=count))

    def count(self, topic: str) -> int:
        """Rejections on a topic since start."""
        return self._counts.get(topic, 0)

    def take(self) -> list[Rejection]:
        """Remove and return the rejections to publish."""
        waiting, self._waiting = self._waiting, []
        return waiting


class Handler(ABC, Generic[M]):
    """Executes or rejects the messages of one topic. Subclasses in this package are subscribed automatically."""

    topic: ClassVar[Topic[Any]]
    after_motor: ClassVar[bool] = False  # whether messages are processed after the Motor of a period, else before it

    def __init__(self, components: Components) -> None:
        self.components = components

    def handle(self, received: Received[M], now: int) -> bool:
        """Execute or reject a message at robot time ``now`` [ns]; returns whether it is accepted."""
        try:
            self.execute(received, now)
        except RefusalError as rejection:
            self.components.rejections.add(self.topic.name, received.origin, rejection.kind, str(rejection))
            return False
        return True

    @abstractmethod
    def execute(self, received: Received[M], now: int) -> None:
        """Execute the message completely at robot time ``now`` [ns]; raises ``RefusalError`` without a change."""


class RequestHandler(ABC, Generic[Q, R]):
    """Replies to the requests of one service topic. Subclasses in this package are served automatically."""

    topic: ClassVar[ServiceTopic[Any, Any]]

    def __init__(self, components: Components) -> None:
        self.components = components

    @abstractmethod
    def handle(self, request: Q, origin: str) -> R:
        """Reply to a request of the node ``origin``."""


AnyHandler = Handler[Any] | RequestHandler[Any, Any]


def make_all(components: Components) -> tuple[AnyHandler, ...]:
    """Make one of each handler in this package."""
    return tuple(found(components) for found in classes(__name__.rpartition(".")[0], Handler, RequestHandler))


def each_joint(names: Sequence[str], known: Container[str]) -> Iterator[str]:
    """Yield names in turn; raises ``RefusalError`` at a joint that is unknown or repeated."""
    for i, name in enumerate(names):
        if name not in known:
            raise RefusalError("names", f"unknown joint {name[:64]!r}; joints are named in robot.yaml")
        if name in names[:i]:
            raise RefusalError("names", f"joint {name!r} is named twice")
        yield name


def require_finite(what: str, vector: FloatArray) -> None:
    """Raise ``RefusalError`` if a number is not finite."""
    if not np.isfinite(vector).all():
        raise RefusalError("number", f"{what} {vector.tolist()} is not finite")


def require_fresh(time: int, now: int) -> None:
    """Raise ``RefusalError`` if a command's state is more than ``STALE`` before or after robot time ``now`` [ns]."""
    age = 1e-9 * (now - time)
    if abs(age) > STALE:
        raise RefusalError("stale", f"made for a state {age:.3f} s old; expected at most {STALE} s")


def pose(position: FloatArray, orientation: FloatArray, norm: float) -> tuple[FloatArray, FloatArray]:
    """Copy position (3,) [m] and rotation (3, 3), with a norm within 1 ± ``norm``; raises ``RefusalError``."""
    if position.shape != (3,) or orientation.shape != (4,):
        raise RefusalError("length", f"position and orientation have {position.size} and {orientation.size} numbers")
    numbers = orientation.tolist()
    if not all(map(isfinite, (*position.tolist(), *numbers))):
        raise RefusalError("number", "position or orientation is not finite")
    if abs(hypot(*numbers) - 1.0) > norm:
        raise RefusalError("number", "the orientation is no unit quaternion")
    matrix = np.empty((3, 3))
    rotation.matrix(rotation.quaternion(orientation), matrix)
    return position.copy(), matrix
