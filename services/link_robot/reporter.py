"""Says how a plan and the hands' goals fare, whoever sent them: what has changed, and of that the newest."""

from __future__ import annotations

from typing import Any

from valor.link.classes import Kind
from valor.link.end import End
from valor.link.errors import SealError
from valor.link_robot.obedience import Obedience
from valor.link_robot.observer import Observer
from valor.ros import packed_steps, progress
from valor.ros.limbs import HANDS
from valor.ros.relayed import Word, worded

PERIOD = 0.1  # between two looks [s]
HAND_PERIOD = 1.0  # between two tellings of how far a hand is from its goal [s]
HAND_STEP = 0.005  # of the error that is worth telling [m]


class Reporter:
    """From the loop's thread."""

    def __init__(self, end: End, observer: Observer, obedience: Obedience) -> None:
        """``observer``: looks by itself; ``obedience``: knows whose goals are whose."""
        self._end, self._observer, self._obedience = end, observer, obedience
        self._due = 0.0
        self._packed: tuple[Any, bytes] = (None, b"")  # a plan's steps, and as they travel: not twice the same bytes
        self.begin()

    def begin(self) -> None:
        """Another session: nothing has been told."""
        self._sent: dict[str, int] = {}  # id of the last message, by what it is of
        self._told: dict[str, Any] = {}
        self._hands: dict[str, tuple[Any, float, float]] = {}  # state and reason, error, when

    def tell(self, now: float) -> None:
        """What is to be told; ``now``: monotonic [s]."""
        if now < self._due or not self._end.session.established:
            return
        self._due = now + PERIOD
        try:
            self._tell_plan(now)
            for place, hand in enumerate(HANDS):
                self._tell_hand(place, hand, now)
        except SealError:  # the other end's clock is not known yet, or too much waits: told next time
            return

    def _tell_plan(self, now: float) -> None:
        message = self._observer.newest("steps")
        if message is None:
            return
        told = message.feedback.feedback.steps
        if told != self._packed[0]:
            self._packed = (told, packed_steps.pack(told) or b"")
        steps = self._packed[1]
        if steps and self._told.get("steps") != steps:
            self._send("steps", worded(Word.STEPS, 0, steps), steps, now)
        number = self._obedience.number_of(message.goal_id)
        content = progress.pack_feedback(message, steps)
        timeless = content[: progress.STAMP.start] + content[progress.STAMP.stop :]
        if self._told.get("progress") != (number, timeless):
            self._send("progress", worded(Word.PROGRESS, number, content), (number, timeless), now)

    def _tell_hand(self, place: int, hand: str, now: float) -> None:
        status = self._observer.newest(hand)
        if status is None:
            return
        words, off = (status.state, status.reason), status.position_error
        told, before, when = self._hands.get(hand, (None, 0.0, 0.0))
        if words != told or (now - when > HAND_PERIOD and abs(off - before) > HAND_STEP):
            self._send(hand, worded(Word.HAND, place, progress.pack_hand(status)), words, now)
            self._hands[hand] = (words, off, now)

    def _send(self, what: str, content: bytes, told: Any, now: float) -> None:
        self._sent[what] = self._end.renew(Kind.PROGRESS, content, now, self._sent.get(what, 0))
        self._told[what] = told
