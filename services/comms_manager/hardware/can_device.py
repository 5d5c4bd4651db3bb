"""What the devices on CAN buses have in common: SYNC out, one STATE a unit back; requests; who is who.

The main loop asks for states (``request_states``); the thread broadcasts SYNC, gathers what is answered, and hands it
over when all units that were heard lately have answered, or when the time for that is up.
"""

from __future__ import annotations

import select
import threading
import time
from abc import abstractmethod
from collections.abc import Mapping

import can

from valor.comms_manager.hardware.can_port import CanPort
from valor.comms_manager.hardware.condition import Condition, Limits, require_identity
from valor.comms_manager.hardware.device import Ailment, Device, DeviceContext, DeviceError, Fault, UnitRecord
from valor.devices import can_frames
from valor.devices.can_frames import Code, Identity, Reply
from valor.devices.end_to_end import is_sound
from valor.devices.ports import open_can
from valor.devices.table import SupplyLimits

GATHERING = 0.0015  # from SYNC until states are handed over, whoever has not answered [s]
ABSENT_AFTER = 10  # SYNCs without an answer, after which nobody waits for a unit any more
ANSWER_TIME = 0.1  # of a request [s]
TRIES = 20  # of a request, at start
TEND_EVERY = 0.1  # units that are not as they should be are asked [s]
_IDLE = 0.02  # longest sleep of the thread [s]


class CanUnit:
    """A unit as its device knows it."""

    def __init__(self, number: int, identity: Identity, device: str, supply: SupplyLimits) -> None:
        self.number = number
        self.identity = identity  # that it must have
        self.name = f"{device}/{number}"
        self.record = UnitRecord(str(number))
        self.missed = ABSENT_AFTER  # SYNCs in a row without an answer
        self.condition = Condition(self.record, Limits(supply.warm, supply.hot, supply.low, supply.flat))
        self.ailments: tuple[tuple[Ailment, ...], tuple[Ailment, ...]] = ((), ())  # of its condition, and others


class CanDevice(Device):
    """Units that sample on SYNC.

    Attributes:
        gathered: is set when the states asked for last have been handed over.
        units: by number.
        elapsed: by the units' own clocks, since ``find``, as far as they answered [ns].
    """

    def __init__(self, name: str, context: DeviceContext, bus: int, units: Mapping[int, CanUnit], length: int) -> None:
        """``length``: of a STATE [B]."""
        super().__init__(name, context)
        self.units = units
        self.records = tuple(unit.record for unit in units.values())
        self.gathered = threading.Event()
        self._number, self._length = bus, length
        self._bus: CanPort | None = None
        self._states_wanted = False
        self._counter = 0
        self._synced = 0  # when SYNC was sent last, monotonic [ns]
        self._missing: set[int] = set()  # who has not answered it
        self._awaited: set[int] = set()  # of those, who is waited for
        self._replies: dict[int, Reply] = {}
        self._tended = 0.0
        self._failure = ""  # of the bus itself, now
        self._now: int | None = None  # ``elapsed`` as of this SYNC, if a unit has said [ns]
        self.elapsed = 0

    # --- for the main loop ----------------------------------------------------------------------------------------

    def request_states(self) -> None:
        """Have all units sample now; ``gathered`` is set when that is in."""
        self.gathered.clear()
        self._states_wanted = True
        self.wake()

    def await_states(self) -> None:
        """Wait until that is in, or the time for it is up, twice over."""
        self.gathered.wait(2.0 * GATHERING)

    # --- start and end --------------------------------------------------------------------------------------------

    def find(self) -> None:
        """Ask every unit who it is, and get a first state of each."""
        self._bus = CanPort(
            lambda: open_can(self.context.settings, self._number, can_frames.TO_MASTER, can_frames.KIND)
        )
        for unit in self.units.values():
            self._check_identity(unit, self._ask(unit, Code.IDENTIFY, f"expected {_described(unit.identity)}"))
        deadline = time.monotonic() + TRIES * ANSWER_TIME
        while not all(record.states for record in self.records):
            if time.monotonic() > deadline:
                mute = next(unit for unit in self.units.values() if not unit.record.states)
                raise DeviceError(f"{mute.name}: it says who it is, but no state came from it after SYNC")
            self._sync()
            while self._missing and time.monotonic_ns() - self._synced < 1e9 * ANSWER_TIME:
                self._listen(ANSWER_TIME)
            self._finish()

    def close(self) -> None:
        """Leave the bus."""
        if self._bus is not None:
            self._bus.close()
            self._bus = None
        super().close()

    def _ask(self, unit: CanUnit, code: Code, expectation: str) -> Reply:
        """Ask a unit until it answers, while no thread does."""
        assert self._bus is not None
        for _ in range(TRIES):
            self._replies.pop(unit.number, None)
            self._bus.send(can_frames.request(unit.number, code))
            deadline = time.monotonic() + ANSWER_TIME
            while (remaining := deadline - time.monotonic()) > 0.0:
                self._listen(remaining)
                reply = self._replies.get(unit.number)
                if reply is not None and reply.code == code:
                    return reply
        raise DeviceError(
            f"{unit.name}: no answer on CAN bus {self._number} within {TRIES * ANSWER_TIME:g} s; {expectation}"
        )

    def _check_identity(self, unit: CanUnit, reply: Reply) -> None:
        require_identity(unit.name, _words(reply.identity), _words(unit.identity))

    # --- the thread -----------------------------------------------------------------------------------------------

    def run(self, stopping: threading.Event) -> None:
        """Exchange frames until told to stop."""
        while not stopping.is_set():
            self._turn()

    def _turn(self) -> None:
        """Wait for what comes, and do what it asks for."""
        assert self._bus is not None
        port, woken = self._bus.fileno(), self.woken
        timeout = _IDLE
        if not self.gathered.is_set() and self._missing:
            timeout = max(0.0, GATHERING - 1e-9 * (time.monotonic_ns() - self._synced))
        try:
            ready, _, _ = select.select((port, woken), (), (), timeout)
            if port in ready:  # first, as it may answer the last SYNC
                self._listen(0.0)
            if woken in ready:
                self.drain_wake()
                if self._states_wanted:
                    self._states_wanted = False
                    self._sync()
                self._send_command()
            if not self.gathered.is_set() and not self._states_wanted and self._is_over():
                self._finish()
                self.gathered.set()
                self.looks += 1
                if self._failure:
                    self._tell_failure("")
            now = time.monotonic()
            if now - self._tended > TEND_EVERY:
                self._tended = now
                self._tend()
        except (can.CanError, OSError) as error:  # the bus itself fails: no unit on it can be reached
            self._tell_failure(f"CAN bus {self._number}: {error}")
            time.sleep(_IDLE)
            self._bus.reopen()

    def _tell_failure(self, failure: str) -> None:
        """Tell of the bus what is wrong with it, for every unit on it; empty: nothing any more."""
        self._failure = failure
        self._tell_ailments()

    def _tell_ailments(self) -> None:
        failing = [Ailment(each.unit, Fault.UNPLUGGED, self._failure) for each in self.records if self._failure]
        units = [ailment for each in self.units.values() for part in each.ailments for ailment in part]
        self.tell([*failing, *units])

    def _is_over(self) -> bool:
        return not (self._missing & self._awaited) or time.monotonic_ns() - self._synced > 1e9 * GATHERING

    def _finish(self) -> None:
        """Hand over what has been gathered, and let the time pass that has passed by the units' clocks."""
        if self._now is not None:
            self.elapsed = max(self.elapsed, self._now)
        self._hand_over()

    def _sync(self) -> None:
        assert self._bus is not None
        self._now = None
        for number in self._missing:
            self.units[number].missed += 1
        self._counter = (self._counter + 1) & 0xFF
        self._missing = set(self.units)
        self._awaited = {number for number, unit in self.units.items() if unit.missed < ABSENT_AFTER}
        self._synced = time.monotonic_ns()
        self._bus.send(can_frames.sync(self._counter))

    def _listen(self, timeout: float) -> None:
        """Take in what is on the bus; wait for the first frame."""
        assert self._bus is not None
        for kind, number, message in self._bus.receive(timeout):
            unit = self.units.get(number)
            if unit is None:
                continue
            if kind == can_frames.STATE:
                self._hear(unit, message)
            elif reply := can_frames.read_reply(message):
                self._replies[unit.number] = reply
            else:
                unit.record.errors += 1

    def _hear(self, unit: CanUnit, message: can.Message) -> None:
        """A STATE: refused if it is not sound, not the answer to this SYNC, or the second one."""
        data, stamp = message.data, time.monotonic_ns()
        sound = len(data) == self._length and is_sound(message.arbitration_id, data)
        if not sound or data[0] != self._counter or unit.number not in self._missing or not self._take(unit, data):
            unit.record.errors += 1
            return
        self._missing.discard(unit.number)
        unit.missed = 0
        unit.record.received(stamp)
        unit.record.answered(1e-9 * (stamp - self._synced))

    def _judge(self, unit: CanUnit, temperature: float, voltage: float, others: tuple[Ailment, ...]) -> None:
        """Write down how a unit fares [°C, V], and tell it when that has changed; ``others``: what else ails it."""
        condition = unit.condition.judge(temperature, voltage)
        if condition is not unit.ailments[0] or others != unit.ailments[1]:
            unit.ailments = (condition, others)
            self._tell_ailments()

    @abstractmethod
    def _take(self, unit: CanUnit, data: bytes | bytearray) -> bool:
        """Take in a sound STATE; returns whether its numbers can be believed."""

    @abstractmethod
    def _hand_over(self) -> None:
        """Replace what it provides by what is known now."""

    def _send_command(self) -> None:
        """Send the newest command, if there is a new one."""

    def _tend(self) -> None:
        """Look after units that are not as they should be; ten times a second."""


def _words(identity: Identity) -> dict[str, object]:
    return {"serial number": identity.serial, "firmware": identity.firmware}


def _described(identity: Identity) -> str:
    return f"serial number {identity.serial}, firmware {identity.firmware}"
