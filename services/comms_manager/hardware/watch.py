"""Watches the devices from the main loop: who is silent, unread, slow or ailing, and what the robot does about it."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from valor.common.behaviors import Reaction
from valor.common.messages import DeviceStatus
from valor.comms_manager.hardware.attitude import FRESH, tilt_between
from valor.comms_manager.hardware.device import RATE_WINDOW, Device, Fault, Part, UnitRates, providers
from valor.comms_manager.hardware.faults import LEGS_TO_LIMP, REACTIONS, SPOKEN
from valor.devices.kinds import Quantity

STATUS_PERIOD = 1.0  # between reports while nothing changes [s]
HALF_RATE = 0.5  # of the rate that states should have: less is slow
COMPARE_EVERY = 0.1  # the tilts of several IMUs [s]
DISAGREEMENT = 0.05  # between two of them, from which on the one that stands by is not to lead [rad]
LOOKS_TO_SILENCE = 3  # at a port that brought nothing, before it is its unit that is silent
# Of robot time without a look at a port, after which the robot is to be made safe [s]. Blind for 0.2 s it walks on, for
# 0.3 s it fell in two runs of three; standing, it bears 0.3 s (benchmarks/blind_imu.py).
UNREAD_AFTER = 0.2
_UNREAD = round(1e9 * UNREAD_AFTER)
_log = logging.getLogger("comms_manager")

_STATES = (Fault.UNPLUGGED, Fault.SILENT, Fault.UNREAD, Fault.OVERDUE, Fault.DISABLED)
"""Faults that are words of ``DeviceStatus.states``, the worst first; all others are ``faulty``."""


@dataclass(frozen=True, slots=True)
class Trouble:
    """A fault, and what the robot does about it."""

    unit: str  # device/unit
    device: Device
    part: Part
    fault: Fault
    detail: str
    reaction: Reaction


class _Unit:
    """What the watch keeps of one unit."""

    def __init__(self, device: Device, row: int) -> None:
        self.device = device
        self.record = device.records[row]
        # A device of one unit goes by its own name.
        self.name = f"{device.name}/{self.record.unit}" if self.record.unit != device.name else device.name
        self.part = device.part(self.record.unit)
        self.rates = UnitRates(self.record)
        self.silent_after = round(1e9 * device.silent_after)
        self.silent = self.slow = False
        self.was_silent = False  # since rates were taken last
        self.unread: Fault | None = None  # or ``OVERDUE``
        self._states = self._looks = 0
        self._looks_in_vain = 0  # since the newest state
        # Robot time at which its port was seen to have been looked at, and its newest state was there [ns].
        self._looked = self._heard = -1

    @property
    def not_read(self) -> str:
        """For people."""
        seconds = UNREAD_AFTER if self.unread is Fault.UNREAD else 1e-9 * self.silent_after
        return f"the computer has not read it for {seconds:g} s; the unit itself may be well"

    def look(self, now: int) -> bool:
        """See at robot time ``now`` [ns] whether it is silent, or nobody listens; returns whether that has changed.

        It is silent as long as somebody listened in vain: a thread that does not get its turn, or a kernel that does
        not pass on what it has, is the computer's fault. What was not listened to counts for nothing, in either way.
        """
        # In this order: a state that comes in between is one of the next look.
        looks, states = self.device.looks, self.record.states
        if self._heard < 0:
            self._looked = self._heard = now
        if looks != self._looks:
            self._looks_in_vain += looks - self._looks
            self._looks, self._looked = looks, now
        if states != self._states:
            self._states, self._heard, self._looks_in_vain = states, now, 0
            self._looked = now
        silent = self._looked - self._heard > self.silent_after and self._looks_in_vain >= LOOKS_TO_SILENCE
        away = now - self._looked
        unread = Fault.UNREAD if away > _UNREAD else Fault.OVERDUE if away > self.silent_after else None
        changed = silent is not self.silent or unread is not self.unread
        self.silent, self.unread = silent, unread
        self.was_silent |= silent
        return changed


class DeviceWatch:
    """Watches all devices.

    Of several that provide an attitude the first of robot.yaml leads, and goes on leading as long as no other is
    better off: every change is a jump of what the robot knows of itself, however small. One whose tilt is not that of
    the leader is not well: which of two is right nobody knows, but the robot balances by the leader's.

    Attributes:
        troubles: what is wrong now.
        reaction: the gravest among them.
        leader: whose attitude is the robot's; None: no device provides one.
    """

    def __init__(self, devices: Sequence[Device]) -> None:
        self._units = [_Unit(device, row) for device in devices for row in range(len(device.records))]
        self._devices = devices
        self._imus = providers(devices, Quantity.ATTITUDE)
        self._seen: tuple[object, ...] = ()
        self._rates_due = self._due = self._compare_at = 0.0
        self._disagreeing: dict[str, str] = {}  # IMUs that stand by → what is said of it
        self.troubles: tuple[Trouble, ...] = ()
        self.reaction = Reaction.KEEP_BALANCE
        self.leader = self._imus[0] if self._imus else None

    def update(self, now: int) -> bool:
        """Look at all devices at robot time ``now`` [ns]; returns whether a report is due."""
        changed = False
        for unit in self._units:
            changed |= unit.look(now)
        seconds = 1e-9 * now
        changed |= self._compare(seconds)
        if seconds >= self._rates_due:
            self._rates_due = seconds + RATE_WINDOW
            changed |= self._look_at_rates(seconds)
        ailments = tuple(device.ailments for device in self._devices)
        if any(a is not b for a, b in zip(ailments, self._seen, strict=False)) or not self._seen:
            self._seen, changed = ailments, True
        if changed:
            self._judge()
        if changed or seconds >= self._due:
            self._due = seconds + STATUS_PERIOD
            return True
        return False

    def _compare(self, now: float) -> bool:
        """Hold the tilts of those that stand by against the leader's, ten times a second; what was found last holds.

        Returns whether somebody disagrees now, or does no more.
        """
        if len(self._imus) < 2 or now < self._compare_at or self.leader is None or self.leader.attitude is None:
            return False
        self._compare_at = now + COMPARE_EVERY
        leading, oldest = self.leader.attitude, time.monotonic_ns() - FRESH
        before = dict(self._disagreeing)
        for imu in self._imus:
            if imu is self.leader or imu.attitude is None or min(imu.attitude.stamp, leading.stamp) < oldest:
                continue
            apart = tilt_between(imu.attitude, leading)
            self._disagreeing.pop(imu.name, None)
            if apart > DISAGREEMENT:
                text = (
                    f"its tilt is {apart:.2f} rad off that of {self.leader.name}; expected up to {DISAGREEMENT:g} rad"
                )
                self._disagreeing[imu.name] = before.get(imu.name, text)
        return before != self._disagreeing

    def _look_at_rates(self, now: float) -> bool:
        changed = False
        for unit in self._units:
            unit.rates.update(now)
            # Of a window in which it was silent, that is what was told of it.
            slow = not (unit.silent or unit.was_silent) and unit.rates.rate < HALF_RATE * unit.device.rate
            unit.was_silent = unit.silent
            if slow is not unit.slow:
                unit.slow, changed = slow, True
        return changed

    def _judge(self) -> None:
        """Find out what is wrong, who leads, and what the robot is to do about it; log what has changed."""
        before, troubles = self.troubles, [trouble for unit in self._units for trouble in _troubles(unit)]
        troubles += [
            _trouble(unit, Fault.FAULTY, self._disagreeing[unit.device.name])
            for unit in self._units
            if unit.device.name in self._disagreeing and unit.device is not self.leader
        ]
        if len(self._imus) > 1:
            troubles = self._choose_leader(troubles)
        self.troubles = tuple(troubles)
        powerless = {each.unit for each in troubles if each.part is Part.LEGS and each.fault is Fault.DISABLED}
        reaction = _gravest(troubles)
        if len(powerless) >= LEGS_TO_LIMP:
            reaction = Reaction.LIMP
            if self.reaction is not reaction:
                _log.warning("%s: without motors: %s", ", ".join(sorted(powerless)), SPOKEN[reaction])
        self.reaction = reaction
        known = {(trouble.unit, trouble.fault) for trouble in before}
        for trouble in troubles:
            if (trouble.unit, trouble.fault) not in known:
                _log.warning("%s: %s: %s", trouble.unit, trouble.detail, SPOKEN[trouble.reaction])
        left = {(trouble.unit, trouble.fault) for trouble in troubles}
        for trouble in before:
            if (trouble.unit, trouble.fault) not in left:
                _log.info("%s: no longer %s", trouble.unit, trouble.fault.replace("_", " "))

    def _choose_leader(self, troubles: Sequence[Trouble]) -> list[Trouble]:
        """Have the IMU lead that is best off; what ails the others harms nobody."""
        assert self.leader is not None
        gravest = {
            imu: _gravest(each for each in troubles if each.device is imu)
            for imu in (self.leader, *self._imus)  # the one that leads goes first among equals
        }
        leader = min(gravest, key=lambda imu: gravest[imu].severity)
        if leader is not self.leader:
            _log.warning("%s: leads: the robot's attitude is its", leader.name)
        self.leader = leader
        return [
            replace(each, reaction=Reaction.KEEP_BALANCE, detail=f"{each.detail} ({leader.name} leads)")
            if each.device in gravest and each.device is not leader
            else each
            for each in troubles
        ]

    @property
    def reason(self) -> str:
        """The gravest trouble in one line, the device named; empty: none."""
        gravest = max(self.troubles, key=lambda trouble: trouble.reaction.severity, default=None)
        return "" if gravest is None else f"{gravest.unit}: {gravest.detail}"

    def report(self, robot_time: int) -> DeviceStatus:
        """How all units fare."""
        now = time.monotonic()
        faults: dict[str, list[Trouble]] = {}
        for trouble in self.troubles:
            faults.setdefault(trouble.unit, []).append(trouble)
        units = self._units
        return DeviceStatus(
            time=robot_time,
            units=[unit.name for unit in units],
            states=[_state(faults.get(unit.name, [])) for unit in units],
            details=[self._details(unit, faults.get(unit.name, [])) for unit in units],
            rate=np.array([unit.rates.rate for unit in units]),
            latency=np.array([unit.rates.latency for unit in units]),
            age=np.array([unit.rates.age(now) for unit in units]),
            temperature=np.array([unit.record.temperature for unit in units]),
            voltage=np.array([unit.record.voltage for unit in units]),
            errors=np.array([float(unit.record.errors) for unit in units]),
            reaction=self.reaction,
            reason=self.reason,
        )

    def _details(self, unit: _Unit, troubles: Sequence[Trouble]) -> str:
        """In words; of several IMUs that are well, too: which of them leads."""
        if not troubles and len(self._imus) > 1 and unit.device in self._imus:
            return "leads" if unit.device is self.leader else "stands by"
        return "; ".join(trouble.detail for trouble in troubles)


def _troubles(unit: _Unit) -> Iterator[Trouble]:
    """What is wrong with a unit."""
    faults: list[tuple[Fault, str]] = []
    if unit.silent:
        faults.append((Fault.SILENT, f"no sound state for {1e-9 * unit.silent_after:g} s"))
    elif unit.unread is not None:
        faults.append((unit.unread, unit.not_read))
    elif unit.slow:
        faults.append((Fault.SLOW, f"{unit.rates.rate:.0f} states a second; expected {unit.device.rate:g}"))
    faults += [(each.fault, each.detail) for each in unit.device.ailments if each.unit == unit.record.unit]
    for fault, detail in faults:
        yield _trouble(unit, fault, detail)


def _trouble(unit: _Unit, fault: Fault, detail: str) -> Trouble:
    return Trouble(unit.name, unit.device, unit.part, fault, detail, REACTIONS[fault][unit.part])


def _state(troubles: Sequence[Trouble]) -> str:
    for fault in _STATES:
        if any(trouble.fault is fault for trouble in troubles):
            return str(fault)
    return "faulty" if troubles else "ok"


def _gravest(troubles: Iterable[Trouble]) -> Reaction:
    """What several of them demand together."""
    reactions = (trouble.reaction for trouble in troubles)
    return max(reactions, key=lambda reaction: reaction.severity, default=Reaction.KEEP_BALANCE)
