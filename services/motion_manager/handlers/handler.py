"""What every handler is alike in: one topic, what is done with what comes in on it, and how that is refused."""

from __future__ import annotations

from abc import ABC, abstractmethod
from importlib import import_module
from math import hypot, isfinite
from pkgutil import iter_modules
from typing import Any, ClassVar, Generic, Self, TypeVar

import numpy as np

from bifrost import Message, Received
from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.common.errors import RefusalError
from valor.common.topics import ServiceTopic, Topic
from valor.motion_manager.handlers.rejections import Rejections
from valor.motion_manager.parts import Parts

STALE = 0.5  # what was made for a state older than this is refused [s of robot time]

M = TypeVar("M", bound=Message)
Q = TypeVar("Q", bound=Message)
R = TypeVar("R", bound=Message)


class Handler(ABC, Generic[M]):
    """Obeys the messages of one topic, or refuses them. A subclass in this folder is subscribed without further ado.

    Attributes:
        topic: its line of the table.
        after_motor: what comes with a Proprioceptor is dealt with once the Motor has left, else before.
    """

    topic: ClassVar[Topic[Any]]
    after_motor: ClassVar[bool] = False

    def __init__(self, rejections: Rejections) -> None:
        """``rejections``: where refusals are counted."""
        self._rejections = rejections

    @classmethod
    @abstractmethod
    def of(cls, parts: Parts) -> Self:
        """The one of a Motion Manager."""

    def handle(self, received: Received[M], now: int) -> bool:
        """Obey a message or refuse it, at robot time ``now`` [ns]; returns whether it is obeyed."""
        try:
            self.obey(received, now)
        except RefusalError as refusal:
            self._rejections.add(self.topic.name, received.origin, refusal.kind, str(refusal))
            return False
        return True

    @abstractmethod
    def obey(self, received: Received[M], now: int) -> None:
        """Do what a message asks for; it is obeyed whole or not at all.

        Raises:
            RefusalError: it is not; nothing has changed.
        """


class RequestHandler(ABC, Generic[Q, R]):
    """Answers the requests of one request–reply topic. A subclass in this folder is served without further ado.

    Attributes:
        topic: its line of the table.
    """

    topic: ClassVar[ServiceTopic[Any, Any]]

    @classmethod
    @abstractmethod
    def of(cls, parts: Parts) -> Self:
        """The one of a Motion Manager."""

    @abstractmethod
    def handle(self, request: Q, origin: str) -> R:
        """Answer a request of the node ``origin``."""


AnyHandler = Handler[Any] | RequestHandler[Any, Any]


def make_all(parts: Parts) -> tuple[AnyHandler, ...]:
    """One of each handler that this folder has."""
    package = __name__.rpartition(".")[0]
    modules = [import_module(f"{package}.{module.name}") for module in iter_modules(import_module(package).__path__)]
    return tuple(
        thing.of(parts)
        for module in modules
        for thing in vars(module).values()
        if isinstance(thing, type)
        and issubclass(thing, (Handler, RequestHandler))
        and thing.__module__ == module.__name__ != __name__
    )


def require_finite(what: str, vector: FloatArray) -> None:
    """Refuse a vector that is not all numbers.

    Raises:
        RefusalError: it is not.
    """
    if not np.isfinite(vector).all():
        raise RefusalError("number", f"{what} {vector.tolist()} is not finite")


def pose(position: FloatArray, orientation: FloatArray, norm: float) -> tuple[FloatArray, FloatArray]:
    """The position (3,) [m] and the rotation (3, 3) of a pose in a message: arrays of their own.

    Args:
        position: of any length.
        orientation: likewise; w, x, y, z.
        norm: how far that of the orientation may be from 1.

    Raises:
        RefusalError: it is no pose.
    """
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


def require_fresh(time: int, now: int) -> None:
    """Refuse what was made for a state too old, or one that has not been yet; robot time [ns].

    Raises:
        RefusalError: it is stale.
    """
    age = 1e-9 * (now - time)
    if abs(age) > STALE:
        raise RefusalError("stale", f"made for a state {age:.3f} s old; expected at most {STALE} s")
