"""The modules' bus: which segments are there, who they are, and one exchange with each in every cycle."""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass

import can

from valor.devices import hdt_bus
from valor.devices.table import HdtLimb
from valor.hdt_driver.limb import Limb

MISSES = 15  # cycles without an answer, after which a segment is silent
AT_ONCE = 64  # frames that have come already are taken when a cycle is over, at most
INQUIRE_EVERY = 0.2  # whom one does not know [s]

_log = logging.getLogger("hdt_driver")


@dataclass
class Segment:
    """A gateway and its modules.

    Attributes:
        number: on the bus.
        limb: that it belongs to.
        part: which of the limb's joints it has.
        identity: what robot.yaml says of it.
        known: it has said who it is, and is who it should be.
        answered: in this cycle.
        missed: cycles without an answer.
        wrong: what is wrong with who it says it is.
        refused: frames of it that were nonsense, or said twice or in the wrong order.
        newest: count of its newest state.
    """

    number: int
    limb: Limb
    part: slice
    identity: HdtLimb
    known: bool = False
    answered: bool = False
    missed: int = 0
    wrong: str = ""
    refused: int = 0
    newest: int | None = None

    def is_news(self, sequence: int) -> bool:
        """Whether a state is newer than all before; its count goes round at 65536."""
        if self.newest is not None and not 0 < (sequence - self.newest) & 0xFFFF < 0x8000:
            return False
        self.newest = sequence
        return True


class ModuleBus:
    """Talks to the segments of all limbs.

    Attributes:
        segments: by number.
        errors: frames that nobody could read.
    """

    def __init__(self, bus: can.BusABC, limbs: list[tuple[Limb, HdtLimb]]) -> None:
        """``limbs`` have their segments' numbers in order."""
        self._bus = bus
        self.segments: list[Segment] = []
        for limb, identity in limbs:
            for part in limb.parts:
                self.segments.append(Segment(len(self.segments), limb, part, identity))
        self._of = {limb.name: [each for each in self.segments if each.limb is limb] for limb, _ in limbs}
        self.errors = 0
        self._frame = 0
        self._inquire_at = 0.0

    def wrong(self) -> dict[str, str]:
        """Limb → what is wrong with the first of its segments that one does not know, or that has not answered."""
        found: dict[str, str] = {}
        for segment in self.segments:
            if not segment.known or segment.newest is None:
                why = segment.wrong or f"segment {segment.number} does not answer"
                found.setdefault(segment.limb.name, why)
        return found

    def close(self) -> None:
        """Leave the bus."""
        self._bus.shutdown()

    def ask(self, limb: Limb, now: float) -> None:
        """Begin a cycle of a limb: set-points to whom one knows; who are you, to whom one does not."""
        self._frame = self._frame % 0xFFFF + 1
        setpoints = limb.setpoints(self._frame, now)
        whom = []
        for segment in self._of[limb.name]:
            segment.answered = False
            if segment.known:
                whom.append((segment.number, segment.part))
        for frame in hdt_bus.commands(whom, self._frame, setpoints):
            self._send(frame)

    def inquire(self, now: float) -> None:
        """Ask those who they are whom one does not know, now and then."""
        if now < self._inquire_at:
            return
        self._inquire_at = now + INQUIRE_EVERY
        for segment in self.segments:
            if not segment.known:
                self._send(hdt_bus.inquiry(segment.number))

    def listen(self, until: float) -> Limb | None:
        """Take in what the segments say, until a time [s] or until all segments of a limb that are there have answered.

        Returns:
            That limb; None when the time has come.
        """
        late = 0
        while late < AT_ONCE:
            remaining = until - time.monotonic()
            late += remaining <= 0.0
            try:
                frame = self._bus.recv(max(0.0, remaining))
            except can.CanError:
                self.errors += 1
                continue
            if frame is None:
                return None
            segment = self._hear(frame)
            if segment is not None and all(each.answered or not each.known for each in self._of[segment.limb.name]):
                return segment.limb
        return None

    def finish(self, limb: Limb) -> bool:
        """End a cycle of a limb: who has not answered for a while is silent. Returns whether nobody is there."""
        for segment in self._of[limb.name]:
            if segment.answered or not segment.known:
                continue
            segment.missed += 1
            if segment.missed >= MISSES:
                segment.known = False
                limb.silent(segment.part)
                _log.warning("%s: segment %d is silent", limb.name, segment.number)
        return not any(segment.known for segment in self._of[limb.name])

    def _hear(self, frame: can.Message) -> Segment | None:
        """Take one frame in; the segment that has said its state with it."""
        kind, number = hdt_bus.kind_and_segment(frame.arbitration_id)
        if frame.is_extended_id or number >= len(self.segments):
            self.errors += 1
            return None
        segment = self.segments[number]
        try:
            if kind == hdt_bus.IDENTITY:
                self._identify(segment, *hdt_bus.parse_identity(frame))
            elif kind == hdt_bus.STATE and segment.known:
                state = hdt_bus.parse_state(frame, segment.part.stop - segment.part.start)
                if segment.is_news(state.sequence):
                    segment.limb.measured(segment.part, state)
                    news, segment.answered, segment.missed = not segment.answered, True, 0
                    return segment if news else None
                segment.refused += 1
        except hdt_bus.FrameError:
            segment.refused += 1
        return None

    def _identify(self, segment: Segment, serial: str, firmware: str) -> None:
        expected, wrong = segment.identity, ""
        if serial != expected.serial:
            wrong = f"serial number {serial!r}, robot.yaml expects {expected.serial!r}"
        elif firmware != expected.firmware:
            wrong = f"firmware {firmware!r}, robot.yaml expects {expected.firmware!r}"
        if wrong and wrong != segment.wrong:
            _log.error("%s: segment %d has %s", segment.limb.name, segment.number, wrong)
        segment.wrong, segment.known = wrong, not wrong
        segment.missed, segment.newest = 0, None

    def _send(self, frame: can.Message) -> None:
        try:
            self._bus.send(frame)
        except can.CanError:
            self.errors += 1
