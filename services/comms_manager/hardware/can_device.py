"""Base class of devices on CAN buses: SYNC, one STATE per unit in response, requests, and identity.

The main loop requests states: SYNC is broadcast to all buses. ``gather`` provides the STATEs when all units that
responded lately have responded, or after a timeout.
"""

import contextlib
import math
import time
from abc import abstractmethod
from collections.abc import Iterator, Mapping

import can
import numpy as np

from valor.common.errors import ConfigurationError
from valor.comms_manager.hardware.condition import Condition, Limits, require_identity
from valor.comms_manager.hardware.device import (
    Device,
    DeviceContext,
    DeviceError,
    Fault,
    IntVector,
    JointCommands,
    UnitFault,
    UnitRecord,
    WrenchMeasurement,
)
from valor.devices import can_frames
from valor.devices.can_frames import Code, Frame, Reply, is_valid
from valor.devices.ports import CanBus, open_can
from valor.devices.table import FtCan, MotorController, SupplyLimits, WrenchSensor

GATHERING = 0.0015  # timeout of STATEs after SYNC, once a unit has responded [s]
FIRST = 0.003  # timeout of the first of them [s]
ABSENT_AFTER = 10  # SYNCs without a STATE, after which a unit is not waited for
ANSWER_TIME = 0.1  # timeout of a request [s]
TRIES = 20  # of a request, at start
ATTEND_EVERY = 0.1  # period of requests to units with faults [s]
REOPEN_EVERY = 0.5  # period of reopening a bus that fails [s]


class CanUnit:
    def __init__(self, table: MotorController | WrenchSensor, device: str, supply: SupplyLimits) -> None:
        self.table = table
        self.number = table.id
        self.name = f"{device}/{table.id}"
        self.record = UnitRecord(str(table.id))
        self.missed = ABSENT_AFTER  # consecutive SYNCs without an answer
        self.condition = Condition(self.record, Limits(supply.warm, supply.hot, supply.low, supply.flat))
        self.unit_faults: tuple[tuple[UnitFault, ...], tuple[UnitFault, ...]] = ((), ())  # of its condition, and others


class CanDevice(Device):
    """Units that sample on SYNC."""

    def __init__(self, name: str, context: DeviceContext, bus: int, units: Mapping[int, CanUnit], length: int) -> None:
        """``length``: of a STATE [B]."""
        super().__init__(name, context)
        self.units = units  # by number
        self.records = tuple(unit.record for unit in units.values())
        self._number, self._length = bus, length
        self._bus: CanBus | None = None
        self._reopened = 0.0  # [monotonic s]
        self._counter = 0
        self._synced = 0  # when SYNC was sent last, monotonic [ns]
        self._missing: set[int] = set()  # units that have not responded to it
        self._awaited: set[int] = set()  # those of them that are waited for
        self._replies: dict[int, Reply] = {}
        self._attended = 0.0
        self._failure = ""  # present failure of the bus
        self._requested = False  # SYNC was sent, and its responses are still to be provided
        self._now: int | None = None  # ``elapsed`` at this SYNC, if a unit has responded [ns]
        self.elapsed = 0  # time since ``find`` by the units' clocks [ns]

    def request_states(self) -> None:
        with self._failing():
            self._listen(0.0)  # late responses belong to the last SYNC
            self._sync()
            self._requested = True

    def gather(self) -> None:
        """Wait for these states until their timeout, and provide them."""
        if not self._requested:
            return
        self._requested = False
        with self._failing():
            remaining = FIRST
            while remaining > 0.0 and not self._missing.isdisjoint(self._awaited):
                limit = FIRST if len(self._missing) == len(self.units) else GATHERING
                remaining = max(0.0, limit - 1e-9 * (time.monotonic_ns() - self._synced))
                self._listen(remaining)
            self._finish()
            self.looks += 1
            if self._failure:
                self._report_failure("")
            now = time.monotonic()
            if now - self._attended > ATTEND_EVERY:
                self._attended = now
                self._attend()

    def send(self, command: JointCommands) -> None:
        super().send(command)
        with self._failing():
            self._send_command()

    def find(self) -> None:
        """Check the identity of every unit, and receive a first state of each."""
        self._bus = open_can(self.context.settings, self._number, master=True)
        for unit in self.units.values():
            expected = f"expected serial number {unit.table.serial}, firmware {unit.table.firmware}"
            identity = self._request(unit, Code.IDENTIFY, expected).identity
            require_identity(unit.name, unit.table, serial=identity.serial, firmware=identity.firmware)
        deadline = time.monotonic() + TRIES * ANSWER_TIME
        while not all(record.states for record in self.records):
            if time.monotonic() > deadline:
                mute = next(unit for unit in self.units.values() if not unit.record.states)
                raise DeviceError(f"{mute.name}: it sent its identity, but no state after SYNC")
            self._sync()
            while self._missing and time.monotonic_ns() - self._synced < 1e9 * ANSWER_TIME:
                self._listen(ANSWER_TIME)
            self._finish()

    def close(self) -> None:
        if self._bus is not None:
            self._bus.close()
            self._bus = None

    def _request(self, unit: CanUnit, code: Code, expectation: str) -> Reply:
        """Repeat a request until the unit replies; at start."""
        assert self._bus is not None
        for _ in range(TRIES):
            self._replies.pop(unit.number, None)
            self._bus.send([can_frames.request(unit.number, code)])
            deadline = time.monotonic() + ANSWER_TIME
            while (remaining := deadline - time.monotonic()) > 0.0:
                self._listen(remaining)
                reply = self._replies.get(unit.number)
                if reply is not None and reply.code == code:
                    return reply
        raise DeviceError(
            f"{unit.name}: no answer on CAN bus {self._number} within {TRIES * ANSWER_TIME:g} s; {expectation}"
        )

    @contextlib.contextmanager
    def _failing(self) -> Iterator[None]:
        """Report a failure of the bus itself: none of its units can be reached."""
        try:
            yield
        except (can.CanError, OSError) as error:
            assert self._bus is not None
            self._requested = False
            self._report_failure(f"CAN bus {self._number}: {error}")
            self._reopen(self._bus)

    def _reopen(self, old: CanBus) -> None:
        """Reopen the bus, as a reconnected adapter requires; the old one stays open until then."""
        now = time.monotonic()
        if now - self._reopened < REOPEN_EVERY:
            return
        self._reopened = now
        with contextlib.suppress(ConfigurationError):  # not yet
            self._bus = open_can(self.context.settings, self._number, master=True)
            with contextlib.suppress(can.CanError, OSError):
                old.close()

    def _report_failure(self, failure: str) -> None:
        """Report a failure of the bus for each of its units; an empty string ends it."""
        self._failure = failure
        self._report_faults()

    def _report_faults(self) -> None:
        failing = [UnitFault(each.unit, Fault.UNPLUGGED, self._failure) for each in self.records if self._failure]
        units = [unit_fault for each in self.units.values() for part in each.unit_faults for unit_fault in part]
        self.report_faults([*failing, *units])

    def _finish(self) -> None:
        if self._now is not None:
            self.elapsed = max(self.elapsed, self._now)
        self._provide()

    def _sync(self) -> None:
        assert self._bus is not None
        self._now = None
        for number in self._missing:
            self.units[number].missed += 1
        self._counter = (self._counter + 1) & 0xFF
        self._missing = set(self.units)
        self._awaited = {number for number, unit in self.units.items() if unit.missed < ABSENT_AFTER}
        self._synced = time.monotonic_ns()
        self._bus.send([can_frames.sync(self._counter)])

    def _listen(self, timeout: float) -> None:
        assert self._bus is not None
        for message in self._bus.receive(timeout):
            unit, kind = self.units.get(message.identifier & can_frames.UNIT), message.identifier & can_frames.KIND
            if unit is None or kind not in can_frames.TO_MASTER:
                continue
            if kind == can_frames.STATE:
                self._process_state(unit, message)
            elif reply := can_frames.read_reply(message):
                self._replies[unit.number] = reply
            else:
                unit.record.errors += 1

    def _process_state(self, unit: CanUnit, message: Frame) -> None:
        """Process a STATE; rejected if it is invalid, belongs to another SYNC, or is repeated."""
        data, stamp = message.data, time.monotonic_ns()
        valid = len(data) == self._length and is_valid(message.identifier, data)
        if not valid or data[0] != self._counter or unit.number not in self._missing or not self._take(unit, data):
            unit.record.errors += 1
            return
        self._missing.discard(unit.number)
        unit.missed = 0
        unit.record.received(stamp)
        unit.record.answered(1e-9 * (stamp - self._synced))

    def _judge(self, unit: CanUnit, temperature: float, voltage: float, others: tuple[UnitFault, ...]) -> None:
        """Update a unit's temperature and voltage [°C, V], and report changed faults; ``others``: its other faults."""
        condition = unit.condition.judge(temperature, voltage)
        if condition is not unit.unit_faults[0] or others != unit.unit_faults[1]:
            unit.unit_faults = (condition, others)
            self._report_faults()

    @abstractmethod
    def _take(self, unit: CanUnit, data: bytes) -> bool:
        """Process a valid STATE; returns whether its values are plausible."""

    @abstractmethod
    def _provide(self) -> None:
        """Replace the provided measurements by the latest ones."""

    def _send_command(self) -> None:
        """Send the latest command, once."""

    def _attend(self) -> None:
        """Handle units with faults; called every ``ATTEND_EVERY``."""


LARGEST = 20_000.0  # plausible force [N] and torque [N·m]


class ForceTorque(CanDevice):
    """The sensors on one bus."""

    def __init__(self, name: str, context: DeviceContext) -> None:
        table = context.robot.tables.devices[name]
        assert isinstance(table, FtCan)
        supply = context.robot.tables.supply
        units = {sensor.id: CanUnit(sensor, name, supply) for sensor in table.sensors}
        super().__init__(name, context, table.bus, units, can_frames.SENSOR_STATE_LENGTH)
        self._row = {number: row for row, number in enumerate(units)}
        self._stamp: IntVector = np.zeros(len(units), dtype=np.int64)
        self._wrench = np.zeros((len(units), 6))

    def _take(self, unit: CanUnit, data: bytes) -> bool:
        _, _, temperature, *wrench = can_frames.SENSOR_STATE.unpack_from(data)
        if not all(abs(value) < LARGEST for value in wrench):  # NaN is rejected as well
            return False
        row = self._row[unit.number]
        self._wrench[row] = wrench
        self._stamp[row] = time.monotonic_ns()
        self._judge(unit, 0.1 * temperature, math.nan, ())
        return True

    def _provide(self) -> None:
        self.wrench = WrenchMeasurement(self._stamp.copy(), self._wrench.copy())
