"""Plays a recording into an intake: on, at some speed, and from any place."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable

from rclpy.serialization import deserialize_message

from valor.operator_station.intake import STREAM, Intake
from valor.operator_station.tape import Tape, Wanted

SLICE = 1.0 / 15.0  # of which the newest of each stream counts [s]
BEFORE = 1.0  # a place that is gone to, what came is played at least [s]
NANO = 1_000_000_000

_log = logging.getLogger("operator_station")


class Player:
    """Where a recording is. From one thread.

    Attributes:
        intake: what it is played into.
        playing: whether it goes on.
        speed: of the recording's time to the wall's.
        seconds: after the recording's beginning.
        sampled: called after each slice with the recording's time, as of the ages and of the wall [s].
        past: so much of what leads to a place is to be played when it is gone to [s].
        forgotten: called before another place is gone to.
    """

    def __init__(self, tape: Tape, intake: Intake) -> None:
        """Stand at the beginning.

        Args:
            tape: that is played.
            intake: to play into; its wall clock becomes the recording's.
        """
        self._tape, self.intake = tape, intake
        self.sampled: Callable[[float, float], None] = lambda now, wall: None
        self.past: Callable[[], float] = lambda: BEFORE
        self.forgotten: Callable[[], None] = lambda: None
        self.playing, self.speed, self.seconds = True, 1.0, 0.0
        self._broken: set[int] = set()
        intake.wall = lambda: self.wall

    @property
    def wall(self) -> float:
        """When what is shown was, by the recorder's wall clock [s]."""
        return self._tape.begin / NANO + self.seconds

    @property
    def length(self) -> float:
        """Of what has been read [s]."""
        return (self._tape.end - self._tape.begin) / NANO

    def place(self, stamp: int) -> float:
        """Of a moment by the recorder's wall clock [ns], after the recording's beginning [s]."""
        return max(0.0, (stamp - self._tape.begin) / NANO)

    def advance(self, passed: float) -> None:
        """Go on by so much time of the wall's, if it plays; at the end it stands."""
        if not self.playing or not self._tape.begin:
            return
        self._play_to(min(self.seconds + passed * self.speed, self.length))
        if self._tape.whole and self.seconds >= self.length:
            self.playing = False

    def step(self, seconds: float) -> None:
        """Stand, and go on by so much of the recording's time; back if it is negative."""
        self.playing = False
        if seconds < 0.0:
            self.seek(self.seconds + seconds)
        else:
            self._play_to(min(self.seconds + seconds, self.length))

    def seek(self, seconds: float) -> None:
        """Go to a place; what was said on change until then is heard again."""
        goal = max(0.0, min(seconds, self.length))
        self.intake.heard.forget()
        self.forgotten()
        first = max(0.0, goal - max(BEFORE, self.past()))
        begin = self._stamp(first)
        for stamp, number, data in self._tape.told_before(begin):
            self.seconds = (stamp - self._tape.begin) / NANO
            self._take(number, data)
        self.seconds = first
        self._play_to(goal)

    def _play_to(self, goal: float) -> None:
        while self.seconds < goal:
            before, self.seconds = self.seconds, min(goal, self.seconds + SLICE)
            self._hear(self._tape.between(self._stamp(before), self._stamp(self.seconds)))
            self.sampled(self.wall, self.wall)

    def _hear(self, messages: Iterable[tuple[int, int, bytes]]) -> None:
        newest: dict[int, bytes] = {}
        for _, number, data in messages:
            if self.intake.inputs[number].qos is STREAM:
                newest[number] = data
            else:
                self._take(number, data)
        for number, data in newest.items():
            self._take(number, data)

    def _take(self, number: int, data: bytes) -> None:
        given = self.intake.inputs[number]
        try:
            message = deserialize_message(data, given.kind)
        except Exception as error:  # of another version of its type
            if number not in self._broken:
                self._broken.add(number)
                text = f"{given.topic} is not shown: no {given.kind.__name__} as it is here ({error})"
                _log.warning("%s", text)
                self.intake.heard.tell(self.wall, text)
            return
        given.take(message, self.wall)

    def _stamp(self, seconds: float) -> int:
        return self._tape.begin + round(seconds * NANO) if seconds > 0.0 else self._tape.begin - 1


def wanted_of(intake: Intake) -> list[Wanted]:
    """What a tape is to keep for an intake."""
    return [Wanted(each.topic, each.qos is STREAM) for each in intake.inputs]
