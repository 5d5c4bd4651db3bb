"""Monitor of the devices in the main loop: silent, unread, slow and faulty units, and the reaction of the robot."""

import logging
import math
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from valor.common.behaviors import Reaction
from valor.common.messages import DeviceStatus
from valor.comms_manager.hardware.device import Device, Fault, Part, Watched, providers
from valor.comms_manager.hardware.proprioception import FRESH, tilt_between
from valor.devices.kinds import Quantity

STATUS_PERIOD = 1.0  # period of reports without a change [s]
RATE_WINDOW = 1.0  # window of rates and latencies [s]
HALF_RATE = 0.5  # fraction of the nominal rate, below which a unit is slow
COMPARISON_PERIOD = 0.1  # period of comparing the tilts of several IMUs [s]
DISAGREEMENT = 0.05  # of the tilts, from which a stand-by IMU is faulty [rad]
LOOKS_TO_SILENCE = 3  # reads without data, after which the unit is silent
# Robot time without reading a port, after which the robot must be made safe [s]. After 0.2 s it keeps walking, after
# 0.3 s it fell in two runs of three; standing, it tolerates 0.3 s (benchmarks/blind_imu.py).
UNREAD_AFTER = 0.2
LEGS_TO_LIMP = 2  # leg units without motors, from which on the robot cannot carry itself
_log = logging.getLogger("comms_manager")

_STATES = (Fault.UNPLUGGED, Fault.SILENT, Fault.UNREAD, Fault.OVERDUE, Fault.DISABLED)
"""Faults that are values of ``DeviceStatus.states``, the worst first; all others are ``faulty``."""

EFFECTS: Mapping[Reaction, str] = {
    Reaction.KEEP_BALANCE: "the robot continues",
    Reaction.SOFT_STOP: "the robot comes to rest",
    Reaction.HOLD: "the robot holds its joints",
    Reaction.LIMP: "the robot goes limp",
}
"""Human-readable reactions."""

_BALANCE, _STOP, _HOLD = Reaction.KEEP_BALANCE, Reaction.SOFT_STOP, Reaction.HOLD

# fmt: off
_TABLE: Mapping[Fault, tuple[Reaction, ...]] = {
    #                   legs    upper body  IMU     foot      hand        battery
    Fault.SILENT:      (_HOLD,  _BALANCE,   _HOLD,  _STOP,    _BALANCE,   _BALANCE),
    Fault.UNPLUGGED:   (_HOLD,  _BALANCE,   _HOLD,  _STOP,    _BALANCE,   _BALANCE),
    Fault.UNREAD:      (_HOLD,  _BALANCE,   _HOLD,  _STOP,    _BALANCE,   _BALANCE),
    Fault.OVERDUE:     (_BALANCE, _BALANCE, _BALANCE, _BALANCE, _BALANCE,   _BALANCE),
    Fault.SLOW:        (_STOP,  _BALANCE,   _STOP,  _STOP,    _BALANCE,   _BALANCE),
    Fault.FAULTY:      (_HOLD,  _BALANCE,   _HOLD,  _STOP,    _BALANCE,   _BALANCE),
    Fault.DISABLED:    (_HOLD,  _BALANCE,   _HOLD,  _STOP,    _BALANCE,   _BALANCE),
    Fault.ENCODER:     (_HOLD,  _STOP,      _HOLD,  _STOP,    _BALANCE,   _BALANCE),
    Fault.WARM:        (_STOP,  _BALANCE,   _STOP,  _BALANCE, _BALANCE,   _BALANCE),
    Fault.HOT:         (_HOLD,  _STOP,      _HOLD,  _STOP,    _BALANCE,   _STOP),
    Fault.LOW_VOLTAGE: (_STOP,  _BALANCE,   _STOP,  _BALANCE, _BALANCE,   _BALANCE),
    Fault.FLAT:        (_HOLD,  _STOP,      _HOLD,  _STOP,    _BALANCE,   _STOP),
}
# fmt: on

REACTIONS: Mapping[Fault, Mapping[Part, Reaction]] = {
    fault: dict(zip(Part, row, strict=True)) for fault, row in _TABLE.items()
}
"""In addition: with two leg units without motors the robot goes limp; faults of a stand-by IMU have no effect."""


@dataclass(frozen=True, slots=True)
class FaultReaction:
    """A fault, and the robot's reaction to it."""

    unit: str  # device/unit
    device: Watched
    part: Part
    fault: Fault
    detail: str
    reaction: Reaction


class _Unit:
    """State of one unit."""

    def __init__(self, device: Watched, row: int) -> None:
        self.device = device
        self.record = device.records[row]
        # A device of one unit has the unit's name.
        self.name = f"{device.name}/{self.record.unit}" if self.record.unit != device.name else device.name
        self.part = device.part(self.record.unit)
        self.rate = self.latency = math.nan  # of the last window [Hz], and its mean [s]
        self.silent = False  # timeout of its states, although its port was read
        self.slow = False  # its rate is too low
        self.unread: Fault | None = None  # ``UNREAD`` or ``OVERDUE``: its port was not read
        self._was_silent = False  # in this window
        self._window = (math.nan, 0, 0.0, 0)  # start [s], and states, latency_sum, latency_count at that time
        self._states = self._looks = 0
        self._vain_looks = 0  # since the latest state
        self._looked = self._received = -1.0  # time of the last read of its port, and of its latest state [s]

    def check(self, now: float) -> bool:
        """Check for timeouts of states and of reads at robot time ``now`` [s]; returns whether a result has changed.

        A unit is silent only if its port was read without data. A thread or a kernel worker that is not scheduled is
        the computer's fault.
        """
        # In this order: a state received in between belongs to the next check.
        looks, states = self.device.looks, self.record.states
        timeout = self.device.silent_after
        if self._received < 0.0:
            self._looked = self._received = now
        if looks != self._looks:
            self._vain_looks += looks - self._looks
            self._looks, self._looked = looks, now
        if states != self._states:
            self._states, self._received, self._vain_looks = states, now, 0
            self._looked = now
        silent = self._looked - self._received > timeout and self._vain_looks >= LOOKS_TO_SILENCE
        away = now - self._looked
        unread = Fault.UNREAD if away > UNREAD_AFTER else Fault.OVERDUE if away > timeout else None
        changed = silent is not self.silent or unread is not self.unread
        self.silent, self.unread = silent, unread
        self._was_silent |= silent
        return changed

    def end_window(self, now: float) -> bool:
        """Compute rate and latency since the last window; returns whether ``slow`` has changed."""
        record, (start, *before) = self.record, self._window
        counts = (record.states, record.latency_sum, record.latency_count)
        states, latency, answers = (new - old for new, old in zip(counts, before, strict=True))
        self._window = (now, *counts)
        if not math.isnan(start):
            self.rate = states / (now - start)
        self.latency = latency / answers if answers else math.nan
        # For a window with a timeout, only the timeout is reported.
        slow = not (self.silent or self._was_silent) and self.rate < HALF_RATE * self.device.rate
        changed, self.slow, self._was_silent = slow is not self.slow, slow, self.silent
        return changed

    def age(self, now: float) -> float:
        """Age of the latest state at ``now`` [monotonic s]; infinite before the first."""
        return now - self.record.stamp * 1e-9 if self.record.stamp else math.inf

    def reactions(self) -> Iterator[FaultReaction]:
        timeout = self.device.silent_after
        if self.silent:
            yield self.reaction(Fault.SILENT, f"no valid state for {timeout:g} s")
        elif self.unread is not None:
            seconds = UNREAD_AFTER if self.unread is Fault.UNREAD else timeout
            yield self.reaction(self.unread, f"the computer has not read its port for {seconds:g} s")
        elif self.slow:
            yield self.reaction(Fault.SLOW, f"{self.rate:.0f} states a second; expected {self.device.rate:g}")
        for each in self.device.unit_faults:
            if each.unit == self.record.unit:
                yield self.reaction(each.fault, each.detail)

    def reaction(self, fault: Fault, detail: str) -> FaultReaction:
        return FaultReaction(self.name, self.device, self.part, fault, detail, REACTIONS[fault][self.part])


class DeviceWatch:
    """Monitors all devices.

    Of several IMUs the first of robot.yaml is primary, and stays so while no other has less grave faults, as every
    change makes the estimated attitude jump. A stand-by IMU whose tilt differs from the primary's is faulty: the robot
    balances by the primary.
    """

    def __init__(self, devices: Sequence[Device], others: Sequence[Watched] = ()) -> None:
        """``others``: units without a port."""
        self._watched = (*devices, *others)
        self._units = [_Unit(each, row) for each in self._watched for row in range(len(each.records))]
        self._imus = providers(devices, Quantity.ATTITUDE)
        self._unit_faults: tuple[object, ...] = ()
        self._window_due = self._report_due = self._comparison_due = 0.0
        self._disagreeing: dict[str, str] = {}  # stand-by IMU → detail
        self.reactions: tuple[FaultReaction, ...] = ()  # present faults with their reactions
        self.reaction = Reaction.KEEP_BALANCE  # the gravest of them
        self.primary = self._imus[0] if self._imus else None  # IMU of the robot's attitude; None without an IMU

    def update(self, now: int) -> bool:
        """Check all devices at robot time ``now`` [ns]; returns whether a report is due."""
        seconds, changed = 1e-9 * now, False
        for unit in self._units:
            changed |= unit.check(seconds)
        changed |= self._compare(seconds)
        if seconds >= self._window_due:
            self._window_due = seconds + RATE_WINDOW
            for unit in self._units:
                changed |= unit.end_window(seconds)
        unit_faults = tuple(each.unit_faults for each in self._watched)
        if any(a is not b for a, b in zip(unit_faults, self._unit_faults, strict=False)) or not self._unit_faults:
            self._unit_faults, changed = unit_faults, True
        if changed:
            self._judge()
        if changed or seconds >= self._report_due:
            self._report_due = seconds + STATUS_PERIOD
            return True
        return False

    def _compare(self, now: float) -> bool:
        """Compare the tilts of stand-by IMUs with the primary's; returns whether a result changed."""
        if len(self._imus) < 2 or now < self._comparison_due or self.primary is None or self.primary.attitude is None:
            return False
        self._comparison_due = now + COMPARISON_PERIOD
        primary, oldest = self.primary.attitude, time.monotonic_ns() - FRESH
        before = dict(self._disagreeing)
        for imu in self._imus:
            if imu is self.primary or imu.attitude is None or min(imu.attitude.stamp, primary.stamp) < oldest:
                continue
            difference = tilt_between(imu.attitude, primary)
            self._disagreeing.pop(imu.name, None)
            if difference > DISAGREEMENT:
                text = f"its tilt is {difference:.2f} rad off that of {self.primary.name}"
                text = f"{text}; expected up to {DISAGREEMENT:g} rad"
                self._disagreeing[imu.name] = before.get(imu.name, text)
        return before != self._disagreeing

    def _judge(self) -> None:
        """Update faults, primary IMU and reaction; log changes."""
        before, reactions = self.reactions, [each for unit in self._units for each in unit.reactions()]
        reactions += [
            unit.reaction(Fault.FAULTY, self._disagreeing[unit.device.name])
            for unit in self._units
            if unit.device.name in self._disagreeing and unit.device is not self.primary
        ]
        if len(self._imus) > 1:
            reactions = self._choose_primary(reactions)
        self.reactions = tuple(reactions)
        powerless = {each.unit for each in reactions if each.part is Part.LEGS and each.fault is Fault.DISABLED}
        reaction = _gravest(reactions)
        if len(powerless) >= LEGS_TO_LIMP:
            reaction = Reaction.LIMP
            if self.reaction is not reaction:
                _log.warning("%s: without motors: %s", ", ".join(sorted(powerless)), EFFECTS[reaction])
        self.reaction = reaction
        old, new = ({(each.unit, each.fault): each for each in some} for some in (before, reactions))
        for key, each in new.items():
            if key not in old:
                _log.warning("%s: %s: %s", each.unit, each.detail, EFFECTS[each.reaction])
        for unit, fault in old:
            if (unit, fault) not in new:
                _log.info("%s: no longer %s", unit, fault.replace("_", " "))

    def _choose_primary(self, reactions: Sequence[FaultReaction]) -> list[FaultReaction]:
        """Select the IMU with the least grave faults; faults of the others have no effect."""
        assert self.primary is not None
        gravest = {
            imu: _gravest(each for each in reactions if each.device is imu)
            for imu in (self.primary, *self._imus)  # the primary comes first among equals
        }
        primary = min(gravest, key=lambda imu: gravest[imu].severity)
        if primary is not self.primary:
            _log.warning("%s: primary IMU from now on", primary.name)
        self.primary = primary
        return [
            replace(each, reaction=Reaction.KEEP_BALANCE, detail=f"{each.detail} ({primary.name} is primary)")
            if each.device in gravest and each.device is not primary
            else each
            for each in reactions
        ]

    @property
    def reason(self) -> str:
        """The gravest fault in one line, with its device; an empty string without a fault."""
        gravest = max(self.reactions, key=lambda each: each.reaction.severity, default=None)
        return "" if gravest is None else f"{gravest.unit}: {gravest.detail}"

    def report(self, robot_time: int) -> DeviceStatus:
        now = time.monotonic()
        faults: dict[str, list[FaultReaction]] = {}
        for each in self.reactions:
            faults.setdefault(each.unit, []).append(each)
        units = self._units
        return DeviceStatus(
            time=robot_time,
            units=[unit.name for unit in units],
            states=[_state(faults.get(unit.name, [])) for unit in units],
            details=[self._details(unit, faults.get(unit.name, [])) for unit in units],
            rate=np.array([unit.rate for unit in units]),
            latency=np.array([unit.latency for unit in units]),
            age=np.array([unit.age(now) for unit in units]),
            temperature=np.array([unit.record.temperature for unit in units]),
            voltage=np.array([unit.record.voltage for unit in units]),
            errors=np.array([float(unit.record.errors) for unit in units]),
            reaction=self.reaction,
            reason=self.reason,
        )

    def _details(self, unit: _Unit, reactions: Sequence[FaultReaction]) -> str:
        if not reactions and len(self._imus) > 1 and unit.device in self._imus:
            return "primary" if unit.device is self.primary else "stand-by"
        return "; ".join(each.detail for each in reactions)


def _state(reactions: Sequence[FaultReaction]) -> str:
    faults = {each.fault for each in reactions}
    return next((str(fault) for fault in _STATES if fault in faults), "faulty" if faults else "ok")


def _gravest(found: Iterable[FaultReaction]) -> Reaction:
    return max((each.reaction for each in found), key=lambda reaction: reaction.severity, default=Reaction.KEEP_BALANCE)
